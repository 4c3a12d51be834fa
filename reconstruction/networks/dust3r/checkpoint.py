"""The user's DUSt3R checkpoint to a network, without running anything that the file says.

The public files are `{'args': Namespace, 'model': tensors}`, where `args.model` is a constructor call that the public
loader evaluates. Here the pickle may make tensors, plain values and that Namespace only, and the call is parsed: known
names, literal values. Sizes come from both and have to agree.
"""

import argparse
import ast
import math
import re
import warnings
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

from reconstruction.errors import BadRunError
from reconstruction.networks.dust3r.heads import DptSizes
from reconstruction.networks.dust3r.network import Architecture, Dust3r
from reconstruction.tensors import read_tensors

MODEL = "AsymmetricCroCo3DStereo"
LONGEST_CALL = 4000  # characters; the public ones have about 330
_SIZES = {  # name in the call: field of the architecture, and what the public code takes where the call is silent
    "enc_embed_dim": ("encoder_dim", 768),
    "enc_depth": ("encoder_depth", 12),
    "enc_num_heads": ("encoder_heads", 12),
    "dec_embed_dim": ("decoder_dim", 512),
    "dec_depth": ("decoder_depth", 8),
    "dec_num_heads": ("decoder_heads", 16),
    "patch_size": ("patch_px", 16),
}
_ONLY = {  # other names in a call, and the values that can be honoured
    "output_mode": ("pts3d",),
    "depth_mode": (("exp", -math.inf, math.inf),),
    "conf_mode": (("exp", 1, math.inf),),
    "head_type": ("linear", "dpt"),
    "patch_embed_cls": ("PatchEmbedDust3R", "ManyAR_PatchEmbed"),
    "mlp_ratio": (4,),
    "norm_im2_in_dec": (True,),
}
_NO_MATTER = ("img_size", "freeze", "landscape_only", "mask_ratio")  # names that concern the training alone


def load_network(path: Path) -> Dust3r:
    """Load the network stored under `path`, in float32 on the CPU, ready to use.

    Raises BadRunError for a missing, damaged or foreign file, and for sizes that do not agree with its tensors.
    """
    stored = _read(path)
    try:
        state = _state(stored["model"])
        architecture = _architecture(_call(getattr(stored["args"], "model", None)), state)
        with torch.device("meta"):
            network = Dust3r(architecture)
        _check(state, network.state_dict())
    except BadRunError as error:
        raise BadRunError(error.found, error.expected, "give a DUSt3R checkpoint", where=path) from None
    network.load_state_dict(state, assign=True)
    return network.requires_grad_(False).eval()


def _read(path: Path) -> dict:
    with warnings.catch_warnings(action="ignore"), torch.serialization.safe_globals([argparse.Namespace]):
        stored = read_tensors(path, "a DUSt3R checkpoint", "download it again")
    if not isinstance(stored, dict) or not isinstance(stored.get("model"), Mapping) or "args" not in stored:
        raise BadRunError("found another kind of file", "a DUSt3R checkpoint with 'args' and 'model'", where=path)
    return stored


def _state(stored: Mapping[object, object]) -> dict[str, Tensor]:
    """Return the tensors by our names, without those that are there twice; a missing second decoder is the first."""
    state: dict[str, Tensor] = {}
    for name, tensor in stored.items():
        dense = isinstance(tensor, Tensor) and tensor.is_floating_point() and tensor.layout == torch.strided
        if not (isinstance(name, str) and isinstance(tensor, Tensor) and dense):
            raise BadRunError(f"found {str(name)[:60]!r} in the model", "names of floating point tensors")
        name = re.sub(r"\.scratch\.layer_rn\.([0-3])\.", lambda m: f".scratch.layer{int(m[1]) + 1}_rn.", name)
        if not name.startswith("prediction_head."):  # of the pretraining
            state[name] = tensor.float()
    if not any(name.startswith("dec_blocks2.") for name in state):
        first = [name for name in state if name.startswith("dec_blocks.")]
        state |= {name.replace("dec_blocks.", "dec_blocks2.", 1): state[name].clone() for name in first}
    return state


def _call(source: object) -> dict[str, object]:
    """Return the keyword arguments of the constructor call `source`, which is parsed and never run."""
    if not isinstance(source, str) or len(source) > LONGEST_CALL:
        raise BadRunError(f"found args.model of type {type(source).__name__}", "a short constructor call")
    try:
        call = ast.parse(re.sub(r"\binf\b", "1e999", source.strip()), mode="eval").body  # a literal that is infinite
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise BadRunError(f"found args.model {source[:60]!r}", "a constructor call") from None
    name = call.func.id if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) else source[:60]
    if not isinstance(call, ast.Call) or name != MODEL or call.args:
        raise BadRunError(f"found the model {name!r}", f"{MODEL} with named values")
    return {str(keyword.arg): _literal(keyword.value, str(keyword.arg)) for keyword in call.keywords}


def _literal(node: ast.expr, name: str) -> object:
    """Return the value of a literal, a tuple for a list."""
    try:
        value = ast.literal_eval(node)
    except (ValueError, TypeError, RecursionError, MemoryError):
        raise BadRunError(f"found code as the value of {name} in args.model", "a literal") from None
    return tuple(value) if isinstance(value, list) else value


def _architecture(call: Mapping[str, object], state: Mapping[str, Tensor]) -> Architecture:
    unknown = [name for name in call if name not in {"pos_embed", *_SIZES, *_ONLY, *_NO_MATTER}]
    if unknown:
        raise BadRunError(f"found {unknown[0][:60]!r} in args.model, which this network does not have")
    for name, known in _ONLY.items():
        if name in call and call[name] not in known:
            expected = " or ".join(str(value) for value in known)
            raise BadRunError(f"found {name}={str(call[name])[:60]} in args.model", expected)
    rotary = re.fullmatch(r"RoPE(\d{1,6})", str(call.get("pos_embed", "cosine")))
    if not rotary:
        raise BadRunError(f"found pos_embed={str(call.get('pos_embed', 'cosine'))[:60]}", "RoPE and its base")
    sizes = {field: call.get(name, default) for name, (field, default) in _SIZES.items()}
    depths = {"enc_blocks": "encoder_depth", "dec_blocks": "decoder_depth", "dec_blocks2": "decoder_depth"}
    for blocks, field in depths.items():
        stored, said = {n.split(".")[1] for n in state if n.startswith(f"{blocks}.")}, sizes[field]
        if len(stored) != said:
            raise BadRunError(f"found {len(stored)} {blocks} in the model", f"{str(said)[:20]} as args.model says")
    head = "dpt" if call.get("head_type") == "dpt" else "linear"
    dpt = _dpt_sizes(state) if head == "dpt" else DptSizes()
    return Architecture(**sizes, rope_base=float(rotary[1]), head=head, dpt=dpt)  # pyright: ignore[reportArgumentType]


def _dpt_sizes(state: Mapping[str, Tensor]) -> DptSizes:
    prefix = "downstream_head1.dpt."
    try:
        a, b, c, d = (len(state[f"{prefix}act_postprocess.{k}.0.weight"]) for k in range(4))
        return DptSizes((a, b, c, d), *(len(state[prefix + k]) for k in ("scratch.layer1_rn.weight", "head.2.weight")))
    except (KeyError, TypeError) as error:
        raise BadRunError("found no DPT head in the model, which args.model promises") from error


def _check(found: Mapping[str, Tensor], expected: Mapping[str, Tensor]) -> None:
    odd = [f"without {name}" for name in expected if name not in found]
    odd += [f"with {name[:80]}" for name in found if name not in expected]
    if odd:
        raise BadRunError(f"found a model {odd[0]}", "the layout of DUSt3R")
    for name, tensor in expected.items():
        if found[name].shape != tensor.shape:
            said = f"{tuple(tensor.shape)} as args.model says"
            raise BadRunError(f"found {name} of shape {tuple(found[name].shape)}", said)
        if not bool(torch.isfinite(found[name]).all()):
            raise BadRunError(f"found NaN or infinity in {name}", "finite weights")
