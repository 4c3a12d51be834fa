"""Lists the tables, their rows, and the scenes and seconds that are spent on each.

Labels say what was done. "Small" stands before a network or field that is smaller than the published one; "image
variation" is a loss on images, which the published spike loss (SPSS) is not. `bench rivals` has the novel view against
run time.
"""

from acquisition.scenes.catalog import DEVELOPMENT, EVALUATION, REALISTIC_EVALUATION, STRESS
from reconstruction.bench.conventions import RATE_HZ, SLOWER
from reconstruction.bench.paper import methods as m
from reconstruction.bench.paper.method import Batch, Effort, Method, Protocol, Row, Table
from reconstruction.bench.paper.published import QUICK_MODELS

SHORT, LONG, EQUAL = Effort(30.0), Effort(60.0), Effort(steps=500)
SCENES = (EVALUATION[0], REALISTIC_EVALUATION[0])
NO_DUST3R = "no DUSt3R checkpoint is at hand (its licence forbids to ship one); `--init dust3r` takes one's own"
NO_PRETRAINING = "MSDI's geometry was never pretrained: without a DUSt3R checkpoint there is nothing to leave out"
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
SWEPT = {"auto": "Ours", **{row.method.name: row.label for row in TFI_ROWS if row.method}}  # what diagrams call them
CHAIN = Table(
    "chain",
    "The paper's chain as we read it, with what a row names in place of its own",
    "The small field of 4DGS, small MSDI, SPSS as we read it, on the rig as drawn: 2 degrees, 2 cm and 2 % of focal "
    "length off on average. All rows make as many steps. `rivals` has the chain with the published field.",
    (
        Row("the chain", m.CHAIN["variation"], "Spike4DGS"),
        Row("without SPSS", m.CHAIN["pixels"], "MSDI image, points, poses + 4DGS"),
        Row("L1 spike loss for SPSS", m.CHAIN["l1"], "+ L1 spike loss"),
        Row("L2 spike loss for SPSS", m.CHAIN["l2"], "+ L2 spike loss"),
        *(Row(label, method) for label, method in m.CHAIN_PARTS.items()),
        Row("COLMAP poses, swept points", m.CHAIN_COLMAP["variation"], "MSDI image + COLMAP + SPSS"),
        Row("COLMAP poses, swept points, no SPSS", m.CHAIN_COLMAP["pixels"], "MSDI image + COLMAP + 4DGS"),
        Row("COLMAP poses, swept points, TFI, no SPSS", m.CHAIN_TFI_COLMAP, "TFI + COLMAP + 4DGS"),
        Row("DUSt3R", None, "MSDI image + DUSt3R + SPSS", NO_DUST3R),
        Row("DUSt3R without SPSS", None, "MSDI image + DUSt3R + 4DGS", NO_DUST3R),
        Row("MSDI without pretraining", None, "MSDI without pretraining + SPSS", NO_PRETRAINING),
    ),
)
MODULES = Table(
    "modules",
    "Ours, with what a row names in place of its own",
    "On the rig as drawn; the paper has no such table of a method like ours.",
    (Row("Ours, found poses", m.FOUND), *(Row(label, method) for label, method in m.MODULES.items())),
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
SPIKES = Table(
    "spikes",
    "Methods that learn from spikes alone",
    "True poses. SpikeGS and SpikeNeRF take the clip for one still scene.",
    (
        OURS,
        Row("Dy-SpikeGS", m.SPIKES["dy-spikegs"], "Dy-SpikeGS"),
        Row("SpikeGS (static)", m.SPIKES["spikegs"], "SpikeGS"),
        Row("Dy-SpikeNeRF", m.SPIKES["dy-spikenerf"], "Dy-SpikeNeRF"),
        Row("SpikeNeRF (static)", m.SPIKES["spikenerf"], "SpikeNeRF"),
    ),
)
DEPTH = Table(
    "depth",
    "Depth of the held-out view",
    "Abs Rel and the share within a factor of 1.25, on metric depth with true poses.",
    (OURS, *_rows("small Spk2ImgNet + {}", "Spike2img + {}", m.SPK2IMGNET)),
)
LOSSES = Table(
    "losses",
    "Spike loss",
    "Ours with true poses; the pixel loss on images stays in every row. The published loss has a page of its own.",
    tuple(Row(LOSS_LABELS.get(name, name), method) for name, method in m.LOSSES.items()),
)
RATES = Table(
    "rates",
    "Plane rate",
    "Planes dropped, as the paper does, and re-integrated, as a slower sensor would; scored at the same instants. Ours "
    "where no method is named. The re-integrated rows have a first one of their own sitting.",
    (
        Row(f"{RATE_HZ} Hz", m.AUTO, f"{RATE_HZ} Hz"),
        *(Row(f"{RATE_HZ // k} Hz, dropped", m.slower(m.AUTO, k, "drop"), f"{RATE_HZ // k} Hz") for k in SLOWER),
        Row(f"{RATE_HZ} Hz, run with the re-integrated", m.slower(m.AUTO, 1, "reintegrate")),
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
        for views in range(8, 2, -1)
    ),
)
GAUSSIANS = Table(
    "gaussians",
    "Number of Gaussians",
    "The cap; the paper has no such table.",
    (Row("Ours, 48000", m.AUTO), *(Row(f"Ours, {cap}", m.capped(m.AUTO, cap)) for cap in m.CAPS)),
)
STRESSES = Table(
    "stress",
    "One difficulty each",
    "Ours with true poses on the stress scenes; the paper has no such table.",
    (Row("Ours, true poses", m.AUTO),),
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
_ON_SCENES = (  # the most wanted first
    (SHORT, (VIEWS, RATES)),
    (LONG, (REFERENCES, MODULES, SPIKES, DEPTH)),
    (EQUAL, (CHAIN,)),
    (SHORT, (LOSSES, GAUSSIANS)),
)
PROTOCOL = Protocol(
    (CHAIN, MODULES, REFERENCES, SPIKES, DEPTH, LOSSES, RATES, VIEWS, GAUSSIANS, STRESSES, OUTDOORS, STATIC),
    (
        Batch(STRESSES.name, STRESS, (SHORT,)),
        Batch(OUTDOORS.name, ("outdoor",), (SHORT,)),
        Batch(STATIC.name, ("static",), (LONG,)),
        *(Batch(table.name, SCENES, (length,)) for length, tables in _ON_SCENES for table in tables),
    ),
)

_STEPS = Effort(steps=40)
_QUICK_OURS = m.AUTO.changed("auto", gaussians=3000)
QUICK = Protocol(
    (
        Table(
            "rates",
            RATES.title,
            "A few steps of a small recording: a check of the bench, not a measurement.",
            (
                Row(OURS.label, _QUICK_OURS, OURS.paper),
                Row("10000 Hz, dropped", m.slower(_QUICK_OURS, 2, "drop"), "10000 Hz"),
                Row("TFI + small 4DGS", m.TFI["4dgs-small"].changed("tfi+4dgs-small", gaussians=3000), "TFI + 4DGS"),
                Row("DUSt3R", None, "MSDI image + DUSt3R + 4DGS", NO_DUST3R),
            ),
        ),
    ),
    (Batch("rates", DEVELOPMENT, (_STEPS,)),),
)
