"""Prices of the work in a run, so that a plan can say what leaving it out saves.

Unit costs are seconds of one thread, the least of two or three tries of processor time on a 2-core x86-64 virtual
machine: the development recording `fan_and_ball` seed 1 (eight training views of 400x250, 400 planes, 21% of the pixels
moving), kernels of level v3. They say which work is dear, not how long another machine takes.
- SWEEP_S, SWEEP_MOVERS_S: `swept_maps` of one view against four, 128 hypotheses; 64 at half the width and height where
  movers are.
- BACKGROUND_S: `background` of one view with moving pixels.
- `ImageMethod.price_s`: one plane of one view; `interpolated` looks at the moving pixels alone.
- STEP_S: a step with `pixels`, 12,000 still and 12,000 moving Gaussians.
- POSES_S: `natural` on nine views, a fourfold of the pixels taking twice as long (1.8 to 3.0 s at 200x125).
- VARIATION_STEP_S: a step with `image-variation`, which renders three instants.
- SPLATS_S: what each Gaussian adds to a step, from 12,000 to 24,000 of them.
Images and sweeps grow with the pixels of a view, steps in part with the pixels and in part with the Gaussians.
"""

from dataclasses import dataclass, replace

from reconstruction.images.catalogue import price_s
from reconstruction.methods.ours import BASES

MEASURED_PX = 400 * 250
MEASURED_GAUSSIANS = 24_000
SWEEP_S = 0.079
SWEEP_MOVERS_S = 0.017
BACKGROUND_S = 0.024
POSES_S = 5.0
STEP_S = 0.0225
VARIATION_STEP_S = 0.0424
SPLATS_S = 6.7e-7
FLOAT_BYTES = 4
KEPT_COPIES = 3  # of a trained number: itself and Adam's two moments
A_PIXEL = 2  # most Gaussians for each pixel of a view
PIXELS_EACH = 5  # of a view, for each Gaussian of a method that gets more than its own number
WORTH_STEPS = 1400  # steps, at the prices here, that more Gaussians have to leave
VIEW_DEPENDENT = 3 * 16 - 1  # extra numbers a Gaussian: three channels of third-degree harmonics, not one grey


@dataclass(frozen=True)
class Work:
    """The size of a run: `pixels` of one view, `planes` of the clip, training `views`, Gaussians, and its length.

    Exactly one of `budget_s` and `steps` is given, as in the configuration.
    """

    pixels: int
    planes: int
    views: int
    gaussians: int
    budget_s: float | None
    steps: int | None

    @property
    def scale(self) -> float:
        """Pixels of a view, in pixels of the views that unit costs were measured with."""
        return self.pixels / MEASURED_PX

    def step_s(self) -> float:
        """Return the seconds of one step: a part that grows with the Gaussians and one that grows with the pixels."""
        return SPLATS_S * self.gaussians + (STEP_S - SPLATS_S * MEASURED_GAUSSIANS) * self.scale

    def likely_steps(self) -> int:
        """Return the steps of the run: those asked for, or as many as the budget pays for on one thread."""
        if self.steps is not None:
            return self.steps
        assert self.budget_s is not None
        return round(self.budget_s / self.step_s())

    def with_gaussians(self, usual: int, parts: int) -> "Work":
        """Return the work with the `usual` Gaussians, doubled while pictures and time have use for more.

        A recording of several `parts`, learnt one after the other, divides its time among them.
        """
        found = replace(self, gaussians=min(usual, A_PIXEL * self.pixels))
        while 2 * found.gaussians * PIXELS_EACH <= self.pixels:
            more = replace(found, gaussians=2 * found.gaussians)
            if more.likely_steps() < WORTH_STEPS * parts:
                break
            found = more
        return found

    def movers_s(self) -> float:
        """Return the seconds of looking for movers; steps without any cost nothing more."""
        return self.scale * self.views * (BASES.sweeps * SWEEP_MOVERS_S + BACKGROUND_S)

    def view_s(self) -> float:
        """Return the seconds of preparing one more view: background, sweep, and sweeps of movers."""
        return self.scale * (BACKGROUND_S + SWEEP_S + BASES.sweeps * SWEEP_MOVERS_S)

    def poses_s(self) -> float:
        """Return the seconds of finding the poses of nine views; matching grows little with the pictures' size."""
        return POSES_S * self.scale**0.5

    def images(self, stride: int) -> int:
        """Return the target images of a run with one for every `stride` planes: all, or one a step if that is less."""
        return min(self.views * max(1, self.planes // stride), self.likely_steps())

    def instants_s(self) -> float:
        """Return the seconds of the extra instants that `image-variation` renders in every step."""
        return self.likely_steps() * self.step_s() * (VARIATION_STEP_S / STEP_S - 1)

    def second_instants_s(self, share: float) -> float:
        """Return the seconds of a second instant rendered in a share of the steps."""
        return share * self.instants_s() / 2

    def halving_s(self, share: float) -> float:
        """Return the seconds that a share of the steps spares with pictures of half the width and height."""
        quarter = replace(self, pixels=self.pixels // 4)
        return share * self.likely_steps() * (self.step_s() - quarter.step_s())

    def splats_s(self) -> float:
        """Return the seconds of as many Gaussians again through all steps."""
        return self.likely_steps() * self.gaussians * SPLATS_S

    def image_s(self, method: str) -> float:
        """Return the seconds of one target image."""
        return price_s(method) * self.scale

    def colour_bytes(self) -> int:
        """Return the bytes of colours that depend on the viewing direction, with their moments."""
        return VIEW_DEPENDENT * KEPT_COPIES * FLOAT_BYTES * self.gaussians
