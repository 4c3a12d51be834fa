"""Lists the tables, their rows, and the scenes, seeds and seconds that are spent on each.

Labels say what was done. "Small" stands before a network or field that is smaller than the published one; "image
variation" is a loss on images, which the published spike loss (SPSS) is not.
"""

from acquisition.scenes.catalog import DEVELOPMENT, EVALUATION, STRESS
from reconstruction.bench.conventions import RATE_HZ, SLOWER
from reconstruction.bench.paper import methods as m
from reconstruction.bench.paper.method import Batch, Effort, Method, Protocol, Row, Table
from reconstruction.bench.paper.published import QUICK_MODELS

SHORTEST, SHORT, LONG, LONGEST, UNHURRIED = (Effort(seconds) for seconds in (15.0, 30.0, 60.0, 120.0, 180.0))
NO_DUST3R = "no DUSt3R checkpoint is at hand (its licence forbids to ship one); `--init dust3r` takes one's own"
NO_PRETRAINING = "the MSDI that ships was never pretrained: without a DUSt3R checkpoint there is nothing to leave out"
OURS = Row("Ours, true poses", m.AUTO, "Spike4DGS")
SMALL = {"D3DGS": "D3DGS", "STG": "STG", "4DGS": "small 4DGS"}  # our names for the published models
LOSS_LABELS = {
    "pixels": "none",
    "l1": "L1",
    "l2": "L2",
    "image-variation": "image variation",
    "cumulative": "cumulative counts",
    "both": "counts and image variation",
}


def _rows(form: str, paper: str, methods: dict[str, Method]) -> tuple[Row, ...]:
    """Return a row for each model that learns from images; {} in the two names stands for its name."""
    return tuple(Row(form.format(SMALL[n]), methods[model], paper.format(n)) for n, model in QUICK_MODELS.items())


TFI_ROWS = _rows("TFI + {}", "TFI + {}", m.TFI)
NOVEL_VIEW = Table(
    "novel-view",
    "The held-out centre view",
    "True poses, then (found poses) the rig as drawn: 2 degrees, 2 cm and 2 % of focal length off on average.",
    (
        OURS,
        *TFI_ROWS,
        Row("TFI + 4DGS", m.TFI["4dgs"], "TFI + 4DGS"),
        Row("Dy-SpikeGS", m.SPIKES["dy-spikegs"], "Dy-SpikeGS"),
        Row("SpikeGS (static)", m.SPIKES["spikegs"], "SpikeGS"),
        Row("Ours, found poses", m.FOUND, "Spike4DGS"),
        *_rows("TFI + {}, our poses", "TFI + {}", m.TFI_FOUND),
        Row("TFI + COLMAP + small 4DGS", m.TFI_COLMAP, "TFI + COLMAP + 4DGS"),
        Row("small MSDI image + COLMAP + small 4DGS", m.MSDI_COLMAP["pixels"], "MSDI image + COLMAP + 4DGS"),
        Row("small MSDI images, poses + small 4DGS", m.MSDI["pixels"]),
        Row("+ L1 spike loss", m.MSDI["l1"], "+ L1 spike loss"),
        Row("+ L2 spike loss", m.MSDI["l2"], "+ L2 spike loss"),
        Row(
            "small MSDI image + COLMAP + image variation",
            m.MSDI_COLMAP["image-variation"],
            "MSDI image + COLMAP + SPSS",
        ),
        Row("the paper's chain as we read it, with our points", m.MSDI["image-variation"]),
        Row("small MSDI images, points, poses + small 4DGS", m.MSDI_ALL["pixels"], "MSDI image, points, poses + 4DGS"),
        Row("the paper's chain as we read it", m.MSDI_ALL["image-variation"], "Spike4DGS"),
        Row("MSDI image + DUSt3R + 4DGS", None, "MSDI image + DUSt3R + 4DGS", NO_DUST3R),
        Row("MSDI image + DUSt3R + image variation", None, "MSDI image + DUSt3R + SPSS", NO_DUST3R),
        Row("MSDI without pretraining + image variation", None, "MSDI without pretraining + SPSS", NO_PRETRAINING),
        Row("SpikeNeRF (static)", m.SPIKES["spikenerf"], "SpikeNeRF"),
        Row("Dy-SpikeNeRF", m.SPIKES["dy-spikenerf"], "Dy-SpikeNeRF"),
    ),
)
LOSSES = Table(
    "losses",
    "Spike loss",
    "Ours with true poses; the pixel loss on images stays in every row. None of these is the published SPSS.",
    tuple(Row(LOSS_LABELS.get(name, name), method) for name, method in m.LOSSES.items()),
)
REFERENCES = Table(
    "references",
    "Given images: clean, blurred, and an ordinary camera's",
    "The true light of an instant, and of an exposure of 32 planes without noise, every 20 planes: no camera makes "
    "either. An ordinary camera exposes 99 of 100 planes, 200 times a second, with the noise of its sensor. Masks, "
    "poses and points are the spikes'.",
    (
        OURS,
        Row("Ours on clean images", m.CLEAN),
        Row("Ours on noiseless blurred images", m.BLURRED),
        Row("Ours on an ordinary camera's images", m.ORDINARY),
        Row("clean + our poses + small 4DGS", m.GIVEN["clean"], "clean RGB + DUSt3R + 4DGS"),
        Row("noiseless blurred + our poses + small 4DGS", m.GIVEN["blurred"], "blurred RGB + DUSt3R + 4DGS"),
        Row("an ordinary camera's + our poses + small 4DGS", m.GIVEN["ordinary"], "blurred RGB + DUSt3R + 4DGS"),
    ),
)
DEPTH = Table(
    "depth",
    "Depth of the held-out view",
    "Abs Rel and the share within a factor of 1.25, on metric depth with true poses.",
    (OURS, *_rows("small Spk2ImgNet + {}", "Spike2img + {}", m.SPK2IMGNET)),
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
    (OURS, *TFI_ROWS),
)
STATIC = Table(
    "static",
    "A scene that stands still",
    "The methods that can represent it, a minute each; ours learns from a mean of the whole clip.",
    (
        OURS,
        *TFI_ROWS,
        Row("Dy-SpikeGS", m.SPIKES["dy-spikegs"], "Dy-SpikeGS"),
        Row("SpikeGS", m.SPIKES["spikegs"], "SpikeGS"),
        Row("SpikeNeRF", m.SPIKES["spikenerf"], "SpikeNeRF"),
    ),
)
STRESSES = Table(
    "stress",
    "One difficulty each",
    "Ours with true poses on the stress scenes; the paper has no such table.",
    (Row("Ours, true poses", m.AUTO),),
)
RATES = Table(
    "rates",
    "Plane rate",
    "Planes dropped, as the paper does, and re-integrated, as a slower sensor would; scored at the same instants. Ours "
    "where no method is named.",
    (
        Row(f"{RATE_HZ} Hz", m.AUTO, f"{RATE_HZ} Hz"),
        *(Row(f"{RATE_HZ // k} Hz, dropped", m.slower(m.AUTO, k, "drop"), f"{RATE_HZ // k} Hz") for k in SLOWER),
        *(Row(f"{RATE_HZ // k} Hz, re-integrated", m.slower(m.AUTO, k, "reintegrate")) for k in SLOWER[:4]),
        *(
            Row(f"TFI + {SMALL[name]}, {RATE_HZ // k} Hz, dropped", m.slower(m.TFI[model], k, "drop"))
            for name, model in QUICK_MODELS.items()
            for k in (1, *SLOWER[:4])
        ),
    ),
)
VIEWS = Table(
    "views",
    "Training views",
    "Those nearest to the held-out one, true poses.",
    tuple(
        Row(f"{label}, {views} views", m.seeing(method, views), f"{paper}, {views} views")
        for label, paper, method in (
            ("Ours", "Spike4DGS", m.AUTO),
            *((f"TFI + {SMALL[n]}", f"TFI + {n}", m.TFI[QUICK_MODELS[n]]) for n in ("4DGS", "STG", "D3DGS")),
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
LEADERS = (*(m.TFI[model].name for model in ("stg", "4dgs-small", "d3dgs")), m.SPIKES["dy-spikegs"].name)
SLOW = (  # methods whose networks leave a minute few steps; the first two for comparison
    *(m.FOUND.name, m.TFI_COLMAP.name),
    *(method.name for method in (*m.MSDI_COLMAP.values(), m.MSDI["pixels"], m.MSDI["image-variation"])),
    *(method.name for method in m.MSDI_ALL.values()),
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
        Batch("novel-view", FIRST, (LONG,), (*FOUND, "spikegs", "spikenerf", "dy-spikenerf")),
        Batch("references", FIRST, (LONG,)),
        Batch("gaussians", FIRST, (SHORT,)),
        Batch("rates", FIRST, (SHORT,)),
        Batch("views", THIRD, (SHORT,), tuple(row.method.name for row in VIEWS.rows[:12:2] if row.method)),
        Batch("outdoors", ("outdoor",), (SHORT,)),
        Batch("stress", STRESS, (SHORT,)),
        Batch("novel-view", EVALUATION, (SHORT,), (m.AUTO.name,), seeds=(1, 2)),
        Batch("novel-view", FIRST, (SHORTEST, SHORT), (m.TFI["stg"].name, m.TFI["4dgs-small"].name)),
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
                Row("TFI + small 4DGS", m.TFI["4dgs-small"].changed("tfi+4dgs-small", gaussians=3000), "TFI + 4DGS"),
                Row("10000 Hz, dropped", m.slower(m.AUTO.changed("auto", gaussians=3000), 2, "drop")),
                Row("MSDI image + DUSt3R + 4DGS", None, "MSDI image + DUSt3R + 4DGS", NO_DUST3R),
            ),
        ),
    ),
    (Batch("novel-view", DEVELOPMENT, (_STEPS,)),),
)
