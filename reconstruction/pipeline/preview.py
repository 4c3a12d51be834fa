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

SECOND_S = 1.0  # seconds from the first picture to the second, by which most of the error is gone
GROWTH = 0.5  # share of the training so far that passes until the next picture
COST = 100  # times what a picture took that pass until the next one


class Preview:
    """The picture of one training, by the held-out camera where `rig` has it, or the middle one, half-way through.

    `clock` is in seconds; `white` is the intensity shown as white, spikes per tick.
    """

    def __init__(self, run: RunFolder, rig: Rig, white: float, clock: Callable[[], float]):
        own = rig.camera(run.config.holdout) if run.config.holdout else rig.cameras[len(rig.cameras) // 2]
        self.run, self.white, self.clock = run, white, clock
        self.camera = of_moderate_size(own)
        self.began: float | None = None  # when the first picture was drawn
        self.due = 0.0

    def keep(self, model: SceneModel, steps: int) -> None:
        """Draw what `model` shows after so many steps, where a picture is due."""
        if self.began is None or self.clock() >= self.due:
            self.draw(model, steps)

    def draw(self, model: SceneModel, steps: int) -> None:
        """Draw what `model` shows after so many steps."""
        before = self.clock()
        with nullcontext() if model.networks else kernels_alone():
            view = model.look(self.camera, model.clip.middle_s)
        picture, told = (self.run.path / name for name in PREVIEW)
        write_durably(picture, encode_png(grey(view.intensity, self.white)))
        write_json(told, {"camera": self.camera.id, "steps": steps})
        now = self.clock()
        if self.began is None:
            self.began, self.due = now, now + SECOND_S
        else:
            self.due = now + max(GROWTH * (now - self.began), COST * (now - before))
