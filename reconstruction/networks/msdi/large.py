"""The large tier of MSDI: the small one with the transformers of DUSt3R for a trunk.

DUSt3R's encoder (ViT-Large) looks at each view, its first decoder at each view beside all the others, so that any
number of views in any order will do; its second decoder and its heads are left out. What comes out is added to the
small tier's tokens; correlations, adjustment and sweep are the small tier's. The trunk's weights are the user's DUSt3R
checkpoint, or random; all has to be trained (`train msdi --tier large --backbone FILE`), for no weights ship.
Sources: Wang et al., "DUSt3R", CVPR 2024; Spike4DGS (NeurIPS 2025), whose backbone starts from it.
Letters: V views, N patches a view, D the small tier's dimensions.
"""

from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

from reconstruction.networks.dust3r.blocks import Turns
from reconstruction.networks.dust3r.checkpoint import load_network
from reconstruction.networks.dust3r.network import Architecture, Backbone
from reconstruction.networks.msdi.encoder import TOKEN_WIDTH
from reconstruction.networks.msdi.features import PATCH
from reconstruction.networks.msdi.network import Msdi

LIGHT = 0  # the channel that is shown to the backbone: the square root of light, less its mean


class BackboneTrunk(Backbone):
    """DUSt3R's encoder and first decoder around the tokens of all views; see `encoder.Trunk`.

    `architecture` gives the sizes; its head is not built. Parameters have the names of the checkpoints.
    """

    def __init__(self, architecture: Architecture) -> None:
        super().__init__(architecture)
        self.adapt = nn.Linear(architecture.decoder_dim, TOKEN_WIDTH)
        self.norm = nn.LayerNorm(TOKEN_WIDTH)

    def forward(self, tokens: Tensor, seen: Tensor, gate: Tensor) -> Tensor:
        """Map tokens [V, N, D] of the patches of `seen` [V, CHANNELS, H, W] to tokens; the gate is not used here.

        The views are enlarged until a patch of ours is one of the backbone's.
        """
        a = self.architecture
        grid = (seen.shape[2] // PATCH, seen.shape[3] // PATCH)
        size = (grid[0] * a.patch_px, grid[1] * a.patch_px)
        images = functional.interpolate(seen[:, LIGHT, None].clamp(-1, 1), size=size, mode="bilinear")
        inner = self.decoder_embed(self.encode(images.expand(-1, 3, -1, -1)))
        turns = Turns.of_grid(grid, a.decoder_dim // a.decoder_heads, a.rope_base, images)
        others = Turns(*(part.repeat(len(seen) - 1, 1) for part in turns))
        for block in self.dec_blocks:
            beside = torch.stack([torch.cat([*inner[:v], *inner[v + 1 :]]) for v in range(len(seen))])
            inner = block(inner, beside, turns, others)
        return self.norm(tokens + self.adapt(self.dec_norm(inner)))


def large_msdi(architecture: Architecture | None = None, backbone: Path | None = None) -> Msdi:
    """Build the large tier with a trunk of `architecture` (default: DUSt3R's), or that of the checkpoint `backbone`.

    Raises BadRunError for a file that is no DUSt3R checkpoint.
    """
    if backbone is None:
        return Msdi(BackboneTrunk(architecture or Architecture()))
    stored = load_network(backbone)
    trunk = BackboneTrunk(stored.architecture)
    own = trunk.state_dict()
    found = {name: tensor for name, tensor in stored.state_dict().items() if name in own}
    trunk.load_state_dict(own | found)
    return Msdi(trunk)
