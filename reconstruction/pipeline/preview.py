"""Shows a training while it goes on: `preview.png`, what the model looks like, and `preview.json`, how far it was.

Nothing but the model is read, so a camera that is held out stays unread.
"""

from collections.abc import Callable
from contextlib import nullcontext

from acquisition.durable import write_durably, write_json
from reconstruction.native import kernels_alone
from reconstruction.report.display import grey
from reconstruction.report.pictures import encode_png, of_moderate_size
from reconstruction.run.folder import PREVIEW, RunFolder
from reconstruction.scene_model import SceneModel
from rigs.rig import Rig

SOON_S = 1.0  # seconds between the first pictures; most of the error is gone by the second
GROWTH = 0.5  # share of the training so far that passes until the next picture, later on
FREE_S, SHARE = 0.1, 0.01  # seconds of drawing at any time, and share of the training's seconds beyond them


class Preview:
    """The picture of one training, by the held-out camera where `rig` has it, or the middle one, half-way through.

    `clock` is in seconds; `white` is the intensity shown as white, spikes per tick.
    """

    def __init__(self, run: RunFolder, rig: Rig, white: float, clock: Callable[[], float]):
        own = rig.camera(run.config.holdout) if run.config.holdout else rig.cameras[len(rig.cameras) // 2]
        self.run, self.white, self.clock = run, white, clock
        self.camera = of_moderate_size(own)
        self.began = clock()
        self.due, self.spent_s = self.began, 0.0

    def keep(self, model: Callable[[], SceneModel], steps: int) -> None:
        """Draw what the model that `model` makes shows after so many steps, where a picture is due."""
        now = self.clock()
        if now >= self.due and self.spent_s <= FREE_S + SHARE * (now - self.began):
            self.draw(model(), steps)

    def draw(self, model: SceneModel, steps: int) -> None:
        """Draw what `model` shows after so many steps."""
        before = self.clock()
        with nullcontext() if model.networks else kernels_alone():
            view = model.look(self.camera, model.clip.middle_s)
        picture, told = (self.run.path / name for name in PREVIEW)
        write_durably(picture, encode_png(grey(view.intensity, self.white)))
        write_json(told, {"camera": self.camera.id, "steps": steps})
        now = self.clock()
        self.spent_s += now - before
        self.due = now + max(SOON_S, GROWTH * (now - self.began))
