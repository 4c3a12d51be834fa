"""The blind-spot network: learns from spikes alone, by guessing each pixel's interval without having seen it.

The rate read off one interval between spikes is right on average but off by up to a tick, and pixels are off
independently. A network that has to guess it from everything else can therefore do no better than the light itself.
It sees all bins of the neighbours, through filters with a hole that later, dilated filters cannot fill. Of the pixel
itself it sees only spikes more than `GAP` ticks away. Where guess and interval differ by more than the interval's own
error explains, the image leans towards the interval.
Sources: Krull et al., "Noise2Void", CVPR 2019; Laine et al., "High-quality self-supervised deep image denoising",
NeurIPS 2019 (guess and measurement joined); Wu et al., "Unpaired learning of deep image denoising", ECCV 2020 (dilated
blind spot); Chen et al., "Self-supervised mutual learning for spike cameras", IJCAI 2022. The temporal gap is ours.
"""

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from acquisition.spikes.stream import SpikeStream
from reconstruction.networks.rates import BINS, EDGES, REACH, Floats, bin_rates, charge, planes_around
from reconstruction.networks.spk2imgnet_small import LEAST_SIGMA, ResidualBlock, window_means

GAP, NEAR = 9, 28  # ticks: a pixel's own spikes nearer than GAP are hidden; its bins end at GAP, NEAR and REACH
OWN = 4  # bins of the pixel itself: far and near past, near and far future
CHANNELS, CLOSE = 32, (0, 2, 4, 7)  # windows of the neighbours that are offered as they are
OWN_ERROR = 0.01  # least error, as a share of the light: the spread of the pixels' gain
OWN_SHARE = 0.3  # the guess's own share of the spread; 0.73 of development pixels are then within one sigma


def blind_rates(stream: SpikeStream, plane: int) -> Floats:
    """Return rates in spikes per tick in all bins, then in the pixel's own bins beyond the gap [BINS + OWN, H, W]."""
    planes = planes_around(stream, plane, REACH)
    ticks = np.array([0, REACH - NEAR, REACH - GAP])
    past = np.diff(charge(planes[: REACH - GAP + 1], ticks), axis=0)
    future = np.diff(charge(planes[: REACH + GAP - 1 : -1], ticks), axis=0)[::-1]
    widths = np.array([REACH - NEAR, NEAR - GAP, NEAR - GAP, REACH - NEAR], dtype=np.float32)
    own = np.concatenate([past, future]) / widths[:, None, None]
    return np.concatenate([bin_rates(charge(planes, EDGES + REACH)), own])


def reversed_blind_rates(seen: Floats) -> Floats:
    """Return the `blind_rates` [..., C, H, W] of the stream run backwards."""
    return np.concatenate([seen[..., :BINS, :, :][..., ::-1, :, :], seen[..., BINS:, :, :][..., ::-1, :, :]], axis=-3)


class HoledConvolution(nn.Conv2d):
    """A 3x3 convolution that does not see its middle."""

    def forward(self, input: Tensor) -> Tensor:
        """Convolve [N, C, H, W] to [N, D, H, W]."""
        return self._conv_forward(input, self.weight * _hole(self.weight), self.bias)


class BlindSpotNet(nn.Module):
    """`blind_rates` [N, BINS + OWN, H, W] and the mean light [N, 1, 1, 1] to light and its error, [N, 1, H, W] each.

    While it trains: its guess of the pixel's interval, and how far that will be off; else joined with the interval.
    """

    stride = 1
    windows: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.around = HoledConvolution(BINS + 1, CHANNELS, 3, padding=1)
        self.apart = nn.ModuleList(nn.Conv2d(CHANNELS, CHANNELS, 3, padding=2, dilation=2) for _ in range(4))
        self.own = nn.Conv2d(OWN + 1, CHANNELS, 3, padding=1)
        self.steady = nn.Sequential(ResidualBlock(CHANNELS), ResidualBlock(CHANNELS))
        offers = len(CLOSE) + 3
        self.join = nn.Sequential(
            nn.Conv2d(2 * CHANNELS + OWN + 1 + offers, 96, 1), nn.ReLU(), nn.Conv2d(96, 64, 1), nn.ReLU()
        )
        self.tail = nn.Conv2d(64, offers + 2, 1)
        self.register_buffer("windows", window_means()[list(CLOSE)], persistent=False)
        nn.init.zeros_(self.tail.weight)

    def forward(self, seen: Tensor, mean: Tensor) -> tuple[Tensor, Tensor]:
        """Return light and error, or while training the guess and its spread; see the class."""
        guess, spread = self.guess(seen, mean)
        return (guess, spread) if self.training else joined(guess, spread, seen[:, BINS // 2, None])

    def guess(self, seen: Tensor, mean: Tensor) -> tuple[Tensor, Tensor]:
        """Guess the pixel's rate over its interval without seeing it; return the guess and its standard deviation."""
        rates, own = seen[:, :BINS], seen[:, BINS:]
        now, steady = rates[:, BINS // 2, None], own.mean(dim=1, keepdim=True)
        near = functional.relu(self.around(torch.cat([rates / mean, now * now / mean], dim=1)))
        for layer in self.apart:
            near = near + functional.relu(layer(near))
        known = torch.cat([own / mean, steady * steady / mean], dim=1)
        far = self.steady(functional.relu(self.own(known)))
        offers = torch.cat([*self._offers(rates), own[:, :2].mean(1, True), own[:, 2:].mean(1, True), steady], dim=1)
        out = self.tail(self.join(torch.cat([near, far, known, offers / mean], dim=1)))
        light = (torch.softmax(out[:, :-2], dim=1) * offers).sum(dim=1, keepdim=True) + mean * out[:, -2, None]
        return light, mean * (LEAST_SIGMA + functional.softplus(out[:, -1, None] - 2))

    def _offers(self, rates: Tensor) -> list[Tensor]:
        means = functional.conv2d(rates, self.windows)
        ring = _hole(means).expand(means.shape[1], 1, 3, 3) / 8
        padded = functional.pad(means, (1, 1, 1, 1), mode="replicate")
        return [functional.conv2d(padded, ring, groups=means.shape[1])]


def joined(guess: Tensor, spread: Tensor, interval: Tensor) -> tuple[Tensor, Tensor]:
    """Join the guess and the interval's rate, each as far as it can be trusted; return the light and its error.

    Light r gives intervals of n and n + 1 ticks, n = floor(1 / r), in a mixture with the mean rate r, so with the
    variance (1/n - r)(r - 1/(n + 1)); what `spread` has beyond that is the guess's own error.
    """
    light = guess.clamp(1e-4, 1.0)
    ticks = torch.floor(1 / light)
    noise = ((1 / ticks - light) * (light - 1 / (ticks + 1))).clamp_min(0) + (OWN_ERROR * light) ** 2
    trust = (1 - noise / spread**2).clamp(0, 1)
    blurred = torch.minimum((OWN_SHARE * spread) ** 2, noise)  # an error of the guess that `spread` cannot tell
    least = torch.maximum(blurred, (OWN_ERROR * light) ** 2)
    return guess + trust * (interval - guess), torch.maximum(trust * noise, least).sqrt()


def _hole(like: Tensor) -> Tensor:
    hole = torch.ones(1, 1, 3, 3, dtype=like.dtype, device=like.device)
    hole[..., 1, 1] = 0
    return hole
