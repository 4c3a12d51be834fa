"""The benches by name: how each measures and draws. Imports are late, for a capture host has no torch."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from acquisition.bench_document import BenchDocument
from acquisition.devices.bench import parser_rows
from acquisition.recording.bench import QUICK, Schedule, bench_recorder
from acquisition.recording.compact_bench import bench_compact
from acquisition.recording.reader import Recording
from acquisition.scenes.catalog import DEVELOPMENT, DEVELOPMENT_SEEDS, EVALUATION, REALISTIC, scenes_named
from acquisition.spikes.sensor import SensorKind
from rigs.toml import catalog_rig
from server.cli.bench_asked import QUICK_RIG, QUICK_TICKS, TICKS, Asked, Bench, recording
from server.cli.bench_long import draw_long, long_recordings
from server.cli.bench_speed import draw_large, draw_speed, large, speed
from server.cli.bench_uncertainty import draw_uncertainty, uncertainty

if TYPE_CHECKING:
    from reconstruction.bench.paper.method import Protocol
    from reconstruction.bench.paper.run import Laboratory

_PARSED_BYTES = 10_000_000_000


def _draw(_: Asked, out: Path, found: dict) -> None:
    from reconstruction.bench.diagrams import PLOTS

    PLOTS[found["bench"]](out / f"{found['bench']}.png", found)


def _draw_page(_: Asked, out: Path, found: dict) -> None:
    bench = import_module(f"reconstruction.bench.{found['bench']}")
    bench.write_page(out / f"{found['bench']}.md", found)


def _images(asked: Asked) -> BenchDocument:
    from reconstruction.bench.images import Extent, ImageBench

    extent = Extent(asked.named(EVALUATION), asked.seeds, sweeps=not asked.quick)
    return ImageBench(extent, asked.work / "images", asked.metric_files).run(asked.progress_of("images"))


def _pixels(asked: Asked) -> BenchDocument:
    from reconstruction.bench.pixels import bench_pixels

    return bench_pixels(asked.scenes or DEVELOPMENT[0], asked.seeds)


def _poses(asked: Asked) -> BenchDocument:
    from reconstruction.bench.conventions import KnownRecording, seed_of
    from reconstruction.bench.poses import BOARD_SCENE, BOARD_TICKS, bench_poses

    def known(scene: str, ticks: int = TICKS) -> KnownRecording:
        seed = seed_of(scene)
        return KnownRecording(scene, seed, recording(scene, seed, asked.work, ticks))

    clips = [known(scene) for scene in asked.named(EVALUATION)]
    board = None if asked.quick else known(BOARD_SCENE, BOARD_TICKS)
    return bench_poses(clips, board, asked.work / "poses", asked.progress_of("poses"), quick=asked.quick)


def _rasterizer(asked: Asked) -> BenchDocument:
    from reconstruction.bench.rasterizer import bench_rasterizer

    return bench_rasterizer()


def _recorder(asked: Asked) -> BenchDocument:
    schedule, parsed = (QUICK, _PARSED_BYTES // 10) if asked.quick else (Schedule(), _PARSED_BYTES)
    document = bench_recorder(asked.work / "recorder", schedule, asked.progress_of("recorder"))
    rows, summary = parser_rows(parsed, document.summary["memcpy_gb_s"])
    document.rows += rows
    document.summary |= summary
    return document


def _compact(asked: Asked) -> BenchDocument:
    from reconstruction.bench.scores import real_recordings
    from reconstruction.bench.speed.bench import LARGE_SIZE

    seed, size = DEVELOPMENT_SEEDS[0], "x".join(map(str, LARGE_SIZE))
    ticks, rig = (QUICK_TICKS, QUICK_RIG) if asked.quick else (TICKS, None)
    whole = not (asked.scenes or asked.quick)
    folders = {name: recording(name, seed, asked.work, ticks, rig) for name in asked.named((*DEVELOPMENT, *REALISTIC))}
    if whole:
        folders[f"{DEVELOPMENT[0]}-{size}"] = recording(DEVELOPMENT[0], seed, asked.work / size, size=size)
    simulated = {name: Recording.open(folder) for name, folder in folders.items()}
    streams, missing = real_recordings() if whole else ({}, [])
    found = {name: [stream] for name, stream in streams.items()}
    found |= {name: [one.stream(camera_id) for camera_id in one.camera_ids] for name, one in simulated.items()}
    document = bench_compact(found, asked.progress_of("compact"))
    document.omissions += missing
    return document


def _training(asked: Asked) -> BenchDocument:
    from reconstruction.bench.training.bench import bench_training

    return bench_training(_training_protocol(asked), _laboratory(asked, "training"), asked.progress_of("training"))


def _draw_training(asked: Asked, out: Path, found: dict) -> None:
    from reconstruction.bench.contact_sheet import run_tiles, write_sheet
    from reconstruction.bench.training.bench import shown_cells

    _draw(asked, out, found)
    runs = _laboratory(asked, "training").runs(shown_cells(_training_protocol(asked)))
    write_sheet(out / "training-sheet.png", [run_tiles(clip, run) for clip, run in runs])


def _training_protocol(asked: Asked) -> Protocol:
    """Return the runs of the training bench that were asked for."""
    from reconstruction.bench.training.bench import training_protocol

    scenes = asked.named((*EVALUATION, *DEVELOPMENT)) if asked.scenes or asked.quick else None
    return training_protocol(scenes, quick=asked.quick)


def _tuning(asked: Asked) -> BenchDocument:
    from reconstruction.bench.paper.bench import timer
    from reconstruction.bench.tuning import SCENES, bench_tuning, tuning_protocol

    protocol, progress = tuning_protocol(asked.named(SCENES), quick=asked.quick), asked.progress_of("tuning")
    return bench_tuning(protocol, _laboratory(asked, "tuning"), progress, timer(asked.limit_s))


def _spss(asked: Asked) -> BenchDocument:
    from reconstruction.bench.paper.bench import timer
    from reconstruction.bench.spss import SCENES, bench_spss, spss_protocol

    protocol = spss_protocol(asked.named(SCENES), quick=asked.quick)
    rig = catalog_rig(QUICK_RIG if asked.quick else "lab3x3")
    return bench_spss(protocol, _laboratory(asked, "spss"), rig, asked.progress_of("spss"), timer(asked.limit_s))


def _longer(asked: Asked) -> BenchDocument:
    from reconstruction.bench.longer import SCENES, bench_longer
    from reconstruction.bench.paper.bench import timer

    kinds: tuple[SensorKind, ...] = ("real", "ideal")
    laboratories: dict[SensorKind, Laboratory] = {kind: _laboratory(asked, "longer", kind) for kind in kinds}
    scenes, progress = asked.named(SCENES), asked.progress_of("longer")
    return bench_longer(laboratories, scenes, progress, timer(asked.limit_s), quick=asked.quick)


def _msdi(asked: Asked) -> BenchDocument:
    from reconstruction.bench.msdi import bench_msdi
    from reconstruction.bench.paper.bench import timer

    work, scenes = asked.work / ("msdi-quick" if asked.quick else "msdi"), asked.named(DEVELOPMENT)
    recordings = [] if asked.quick else [recording(scene, DEVELOPMENT_SEEDS[0], asked.work) for scene in scenes]
    return bench_msdi(recordings, work, asked.progress_of("msdi"), quick=asked.quick, time_left=timer(asked.limit_s))


def _leave_out(asked: Asked) -> BenchDocument:
    from reconstruction.bench.leave_out.bench import bench_leave_out
    from reconstruction.bench.paper.bench import timer

    work, progress = asked.work / "leave-out", asked.progress_of("leave-out")
    return bench_leave_out(work, progress, quick=asked.quick, time_left=timer(asked.limit_s))


def _defects(asked: Asked) -> BenchDocument:
    from reconstruction.bench.defects.bench import bench_defects
    from reconstruction.bench.paper.bench import timer

    seed, work, progress = DEVELOPMENT_SEEDS[0], asked.work / "defects", asked.progress_of("defects")
    named = asked.named((*DEVELOPMENT, *REALISTIC))
    usual, drawn = ([(s, seed) for s in named if (s in REALISTIC) == kind] for kind in (False, True))
    return bench_defects(usual, drawn, work, progress, quick=asked.quick, time_left=timer(asked.limit_s))


def _paper(asked: Asked) -> BenchDocument:
    from reconstruction.bench.paper.bench import bench_paper, timer

    return bench_paper(_protocol(asked), _laboratory(asked, "paper"), asked.progress_of("paper"), timer(asked.limit_s))


def _draw_paper(asked: Asked, out: Path, found: dict) -> None:
    from reconstruction.bench.paper.diagrams import write_diagrams
    from reconstruction.bench.paper.tables import write_tables

    write_tables(out / "paper.md", found, _protocol(asked))
    write_diagrams(out, found)


def _protocol(asked: Asked) -> Protocol:
    """Return the part of the paper's protocol that was asked for."""
    from reconstruction.bench.paper.protocol import PROTOCOL, QUICK

    found = _beginning(QUICK if asked.quick else PROTOCOL, asked)
    return found.on(scenes_named(asked.scenes)) if asked.scenes else found


def _beginning(protocol: Protocol, asked: Asked) -> Protocol:
    """Return the protocol with runs begun for the tables that were asked for."""
    return protocol.beginning(tuple(asked.tables.split(","))) if asked.tables else protocol


def _rivals(asked: Asked) -> BenchDocument:
    from reconstruction.bench.paper.bench import timer
    from reconstruction.bench.rivals.bench import bench_rivals

    laboratory, progress = _laboratory(asked, "rivals"), asked.progress_of("rivals")
    return bench_rivals(_rivals_protocol(asked), laboratory, progress, timer(asked.limit_s))


def _draw_rivals(asked: Asked, out: Path, found: dict) -> None:
    from reconstruction.bench.rivals.bench import GROUPS, write_page
    from reconstruction.bench.rivals.sheet import write_rivals_sheet

    _draw(asked, out, found)
    write_page(out / "rivals.md", found, _rivals_protocol(asked))
    write_rivals_sheet(out / "rivals-sheet.jpg", _laboratory(asked, "rivals"), GROUPS["new"].scenes)


def _rivals_protocol(asked: Asked) -> Protocol:
    from reconstruction.bench.rivals.bench import rivals_protocol

    found = _beginning(rivals_protocol(quick=asked.quick), asked)
    return found.beginning_on(scenes_named(asked.scenes)) if asked.scenes else found


def _viewpoints(asked: Asked) -> BenchDocument:
    from reconstruction.bench.paper.methods import AUTO
    from reconstruction.bench.paper.protocol import LONG, QUICK
    from reconstruction.bench.viewpoints import bench_viewpoints

    # The run of each scene that `paper` makes at a minute; those that lack are made.
    cells = QUICK.cells()[:1] if asked.quick else [AUTO.on(scene, LONG) for scene in asked.named(EVALUATION)]
    return bench_viewpoints(_laboratory(asked, "paper").runs(cells), asked.progress_of("viewpoints"))


def _laboratory(asked: Asked, name: str, sensor: SensorKind = "real") -> Laboratory:
    """Return the folder in which the runs of the bench `name` are made and kept, on recordings of such sensors."""
    from reconstruction.bench.paper.run import Laboratory

    def recording_of(scene: str, seed: int) -> Path:
        place = asked.work if sensor == "real" else asked.work / sensor
        if asked.quick and name in ("paper", "rivals", "tuning", "spss", "longer"):
            return recording(scene, seed, place / name / "quick", QUICK_TICKS, QUICK_RIG, sensor=sensor)
        return recording(scene, seed, place, sensor=sensor)

    return Laboratory(asked.work / name, recording_of, asked.progress_of, asked.keep, earlier=asked.earlier_rows())


# In the order of `make bench`: viewpoints and leave-out use the runs of paper.
BENCHES: dict[str, Bench] = {
    "images": Bench("spikes to images", _images, _draw),
    "pixels": Bench("calibrated pixels against pixels taken as even", _pixels),
    "poses": Bench("how well the cameras' poses are found", _poses, _draw),
    "rasterizer": Bench("Gaussians to pixels", _rasterizer, trains=True),
    "recorder": Bench("rings, writers and parser, on the disk of --out", _recorder),
    "compact": Bench("how small recordings become without loss, and how fast", _compact),
    "training": Bench("whole reconstructions, one choice changed at a time", _training, _draw_training, trains=True),
    "paper": Bench("the paper's protocol, its tables and diagrams", _paper, _draw_paper, trains=True),
    "rivals": Bench("ours and its rivals at equal lengths, on new scenes and old", _rivals, _draw_rivals, trains=True),
    "tuning": Bench("learning rates of ours and of its rivals, as many trials each", _tuning, _draw_page, trains=True),
    "spss": Bench("the published spike loss on recorded spikes, by weight", _spss, _draw_page, trains=True),
    "longer": Bench("why longer training may end worse", _longer, _draw_page, trains=True),
    "msdi": Bench("what joint training and pretrained images buy MSDI", _msdi, _draw_page, trains=True),
    "viewpoints": Bench("views that nobody captured, of the runs of paper", _viewpoints, _draw),
    "defects": Bench("what real cameras, light and walls cost, with their cures and without", _defects, _draw),
    "leave-out": Bench("the plan's choices against every one switched", _leave_out, _draw),
    "long": Bench("long recordings in spans, against parts of them alone", long_recordings, draw_long),
    "speed": Bench("how much sooner than an older revision: whole runs and single steps, in turns", speed, draw_speed),
    "uncertainty": Bench("expected errors against true ones", uncertainty, draw_uncertainty, trains=True),
    "large": Bench("whole runs at a million pixels, and of an older revision in turns", large, draw_large),
}
