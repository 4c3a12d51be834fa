"""The tables, their rows, and how much is spent on each: scenes, seeds and seconds stand here and nowhere else."""

from __future__ import annotations

from acquisition.scenes.catalog import DEVELOPMENT, EVALUATION, STRESS
from reconstruction.bench.paper import methods as m
from reconstruction.bench.paper.method import Batch, Effort, Protocol, Row, Table

SHORTEST, SHORT, LONG, LONGEST, UNHURRIED = (Effort(seconds) for seconds in (15.0, 30.0, 60.0, 120.0, 180.0))
NO_DUST3R = "no DUSt3R checkpoint is at hand (its licence forbids to ship one); `--init dust3r` takes one's own"
NO_PRETRAINING = "the MSDI that ships was never pretrained: without a DUSt3R checkpoint there is nothing to leave out"
OURS = Row("Ours, true poses", m.AUTO, "Spike4DGS")
NAMED = (("D3DGS", "d3dgs"), ("STG", "stg"), ("4DGS", "4dgs"))
TFI_ROWS = tuple(Row(f"TFI + {name}", m.TFI[model], f"TFI + {name}") for name, model in NAMED)

NOVEL_VIEW = Table(
    "novel-view",
    "The held-out centre view",
    "True poses, then (found poses) the rig as drawn: 2 degrees, 2 cm and 2 % of focal length off on average.",
    (
        OURS,
        *TFI_ROWS,
        Row("Dy-SpikeGS", m.SPIKES["dy-spikegs"], "Dy-SpikeGS"),
        Row("SpikeGS (static)", m.SPIKES["spikegs"], "SpikeGS"),
        Row("Ours, found poses", m.FOUND, "Spike4DGS"),
        *(Row(f"TFI + {name}, our poses", m.TFI_FOUND[model], f"TFI + {name}") for name, model in NAMED),
        Row("TFI + COLMAP + 4DGS", m.TFI_COLMAP, "TFI + COLMAP + 4DGS"),
        Row("MSDI image + COLMAP + 4DGS", m.MSDI_COLMAP["pixels"], "MSDI image + COLMAP + 4DGS"),
        Row("MSDI images, poses + 4DGS", m.MSDI["pixels"], "MSDI image, points, poses + 4DGS"),
        Row("+ L1 spike loss", m.MSDI["l1"], "+ L1 spike loss"),
        Row("+ L2 spike loss", m.MSDI["l2"], "+ L2 spike loss"),
        Row("MSDI image + COLMAP + SPSS", m.MSDI_COLMAP["spss"], "MSDI image + COLMAP + SPSS"),
        Row("MSDI + SPSS (the paper's own method)", m.MSDI["spss"], "Spike4DGS"),
        Row("MSDI image + DUSt3R + 4DGS", None, "MSDI image + DUSt3R + 4DGS", NO_DUST3R),
        Row("MSDI image + DUSt3R + SPSS", None, "MSDI image + DUSt3R + SPSS", NO_DUST3R),
        Row("MSDI without pretraining + SPSS", None, "MSDI without pretraining + SPSS", NO_PRETRAINING),
        Row("SpikeNeRF (static)", m.SPIKES["spikenerf"], "SpikeNeRF"),
        Row("Dy-SpikeNeRF", m.SPIKES["dy-spikenerf"], "Dy-SpikeNeRF"),
    ),
)  # fmt: skip
LOSSES = Table(
    "losses",
    "Spike loss",
    "Ours with true poses; the pixel loss on images stays in every row.",
    tuple(
        Row(label, m.LOSSES[name])
        for label, name in (
            ("none", "pixels"),
            ("L1", "l1"),
            ("L2", "l2"),
            ("image variation", "image-variation"),
            ("counts", "counts"),
            ("cumulative counts", "cumulative"),
            ("counts and image variation", "both"),
        )
    ),
)
REFERENCES = Table(
    "references",
    "Given images: clean and blurred",
    "The true light of an instant, and of an exposure of 32 planes, every 20 planes; masks and points are the spikes'.",
    (
        OURS,
        Row("Ours on clean images", m.CLEAN),
        Row("Ours on blurred images", m.BLURRED),
        Row("clean + our poses + 4DGS", m.GIVEN["clean"], "clean RGB + DUSt3R + 4DGS"),
        Row("blurred + our poses + 4DGS", m.GIVEN["blurred"], "blurred RGB + DUSt3R + 4DGS"),
    ),
)
DEPTH = Table(
    "depth",
    "Depth of the held-out view",
    "Abs Rel and the share within a factor of 1.25, on metric depth with true poses.",
    (
        OURS,
        *(
            Row(f"Spike2img + {name}", m.SPK2IMGNET[model], f"Spike2img + {name}")
            for name, model in (("D3DGS", "d3dgs"), ("STG", "stg"), ("4DGS", "4dgs"))
        ),
    ),
)
MODULES = Table(
    "modules",
    "One module changed at a time",
    "Ours on the rig as drawn; the paper has no such table of a method like ours.",
    (Row("Ours, found poses", m.FOUND), *(Row(label, method) for label, method in m.MODULES.items())),
)
OUTDOORS = Table(
    "outdoors",
    "Outdoor light",
    "A sun, its shadows and uneven light; the paper's figures are of its real moving car.",
    (
        OURS,
        *TFI_ROWS,
    ),
)  # fmt: skip
STATIC = Table(
    "static",
    "A scene that stands still",
    "What each method that can represent it comes to, given a minute; ours learns from a mean of the whole clip.",
    (
        OURS,
        *TFI_ROWS,
        *(Row(label, m.SPIKES[name]) for label, name in m.SPIKES_ALONE),
    ),
)  # fmt: skip
STRESSES = Table(
    "stress",
    "One difficulty each",
    "Ours with true poses on the stress scenes, which nothing was tuned on; the paper has no such table.",
    (Row("Ours, true poses", m.AUTO),),
)
RATES = Table(
    "rates",
    "Plane rate",
    "Planes dropped, as the paper does, and re-integrated, as a slower sensor would; scored at the same instants.",
    (
        Row("20000 Hz", m.AUTO, "20000 Hz"),
        *(Row(f"{hz} Hz, dropped", m.slower(m.AUTO, every, "drop"), f"{hz} Hz")
          for every in m.SLOWER for hz in (m.RATE_HZ // every,)),
        *(Row(f"{hz} Hz, re-integrated", m.slower(m.AUTO, every, "reintegrate"))
          for every in m.SLOWER[:4] for hz in (m.RATE_HZ // every,)),
    ),
)  # fmt: skip
VIEWS = Table(
    "views",
    "Training views",
    "Those nearest to the held-out one, true poses.",
    tuple(
        Row(f"{label}, {views} views", m.seeing(method, views), f"{paper}, {views} views")
        for label, paper, method in (
            ("Ours", "Spike4DGS", m.AUTO),
            ("TFI + 4DGS", "TFI + 4DGS", m.TFI["4dgs"]),
            ("TFI + STG", "TFI + STG", m.TFI["stg"]),
            ("TFI + D3DGS", "TFI + D3DGS", m.TFI["d3dgs"]),
        )
        for views in range(3, 9)
    ),
)
GAUSSIANS = Table(
    "gaussians",
    "Number of Gaussians",
    "The cap; the paper has no such table.",
    (Row("Ours, 48000", m.AUTO), *(Row(f"Ours, {cap}", m.capped(m.AUTO, cap)) for cap in m.CAPS)),
)
LEADERS = (*(m.TFI[model].name for model in ("stg", "4dgs", "d3dgs")), m.SPIKES["dy-spikegs"].name)
SLOW = (  # whose networks leave a minute few steps; the first two for comparison
    *(m.FOUND.name, m.TFI_COLMAP.name),
    *(method.name for method in (*m.MSDI_COLMAP.values(), m.MSDI["pixels"], m.MSDI["spss"])),
)
FOUND = (m.FOUND.name, *(method.name for method in m.TFI_FOUND.values()), m.TFI_COLMAP.name)
FIRST, THIRD = EVALUATION[:1], EVALUATION[2:3]
PROTOCOL = Protocol(
    (NOVEL_VIEW, LOSSES, REFERENCES, DEPTH, MODULES, OUTDOORS, STATIC, STRESSES, RATES, VIEWS, GAUSSIANS),
    (
        Batch("novel-view", EVALUATION, (LONG,), (m.AUTO.name, *LEADERS)),
        Batch("novel-view", EVALUATION, (SHORTEST, SHORT), (m.AUTO.name,)),
        Batch("references", EVALUATION, (LONG,), (m.CLEAN.name,)),
        Batch("losses", EVALUATION, (SHORT,)),
        Batch("depth", FIRST, (LONG,)),
        Batch("modules", FIRST, (LONG,)),
        Batch("novel-view", FIRST, (LONG,), (*FOUND, m.SPIKES["spikegs"].name, *m.FIELDS)),
        Batch("references", FIRST, (LONG,)),
        Batch("gaussians", FIRST, (SHORT,)),
        Batch("rates", FIRST, (SHORT,)),
        Batch("views", THIRD, (SHORT,), tuple(row.method.name for row in VIEWS.rows[:12:2] if row.method)),
        Batch("outdoors", ("outdoor",), (SHORT,)),
        Batch("stress", STRESS, (SHORT,)),
        Batch("novel-view", EVALUATION, (SHORT,), (m.AUTO.name,), seeds=(1, 2)),
        Batch("novel-view", FIRST, (SHORTEST, SHORT), (m.TFI["stg"].name, m.TFI["4dgs"].name)),
        Batch("static", ("static",), (LONG,)),
        Batch("novel-view", FIRST, (LONG,)),
        Batch("novel-view", FIRST, (UNHURRIED,), SLOW),
        Batch("novel-view", FIRST, (LONGEST,), (m.AUTO.name, *LEADERS)),
        Batch("novel-view", EVALUATION, (SHORT,), LEADERS, seeds=(1, 2)),
        Batch("depth", EVALUATION, (LONG,)),
        Batch("novel-view", EVALUATION, (SHORTEST, SHORT), LEADERS),
        Batch("views", THIRD, (SHORT,)),
        Batch("references", EVALUATION, (LONG,)),
        Batch("modules", EVALUATION, (LONG,)),
        Batch("novel-view", EVALUATION, (LONG,)),
    ),
)

_STEPS = Effort(steps=40)
QUICK = Protocol(
    (
        Table(
            "novel-view",
            NOVEL_VIEW.title,
            "A few steps of a small recording: a check of the bench, not a measurement.",
            (
                Row(OURS.label, m.AUTO.changed("auto", gaussians=3000), OURS.paper),
                Row("TFI + 4DGS", m.TFI["4dgs"].changed("tfi+4dgs", gaussians=3000), "TFI + 4DGS"),
                Row("10000 Hz, dropped", m.slower(m.AUTO.changed("auto", gaussians=3000), 2, "drop")),
                Row("MSDI image + DUSt3R + 4DGS", None, "MSDI image + DUSt3R + 4DGS", NO_DUST3R),
            ),
        ),
    ),
    (Batch("novel-view", DEVELOPMENT, (_STEPS,)),),
)
