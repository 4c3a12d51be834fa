import argparse
import io
import os
import pickle

import pytest
import torch

from reconstruction.errors import BadRunError
from reconstruction.networks.dust3r.checkpoint import load_network
from reconstruction.networks.dust3r.heads import DptSizes
from reconstruction.networks.dust3r.network import Architecture, Dust3r

DPT = Architecture(16, 2, 2, 16, 4, 1, dpt=DptSizes((2, 3, 4, 5), fused=4, last=3))
LINEAR = Architecture(16, 2, 2, 16, 1, 1, head="linear")


def call(architecture, **changed):
    a = architecture
    values = {
        "pos_embed": "'RoPE100'",
        "patch_embed_cls": "'ManyAR_PatchEmbed'",
        "img_size": "(512, 512)",
        "head_type": repr(a.head),
        "output_mode": "'pts3d'",
        "depth_mode": "('exp', -inf, inf)",
        "conf_mode": "('exp', 1, inf)",
        "enc_embed_dim": a.encoder_dim,
        "enc_depth": a.encoder_depth,
        "enc_num_heads": a.encoder_heads,
        "dec_embed_dim": a.decoder_dim,
        "dec_depth": a.decoder_depth,
        "dec_num_heads": a.decoder_heads,
    } | changed
    return f"AsymmetricCroCo3DStereo({', '.join(f'{k}={v}' for k, v in values.items())})"


def network_of(architecture):
    torch.manual_seed(0)
    return Dust3r(architecture)


def stored(path, model, state):
    torch.save({"args": argparse.Namespace(model=model, epochs=100, amp=True), "model": state}, path)
    return path


def refused(path):
    with pytest.raises(BadRunError) as caught:
        load_network(path)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 2
    return str(caught.value)


@pytest.mark.parametrize("architecture", [DPT, LINEAR], ids=["dpt", "linear"])
def test_a_checkpoint_comes_back_with_its_sizes_and_weights(tmp_path, architecture):
    network = network_of(architecture)
    loaded = load_network(stored(tmp_path / "net.pth", call(architecture), network.state_dict()))
    assert loaded.architecture == architecture
    assert not loaded.training
    pictures = torch.rand(2, 3, 32, 48) * 2 - 1
    with torch.no_grad():
        for one, other in zip(*(n(*n.encode(pictures).split(1), (2, 3)) for n in (network, loaded)), strict=True):
            assert torch.equal(one.points, other.points)
            assert torch.equal(one.confidence, other.confidence)


def test_public_quirks_are_understood(tmp_path):
    """The files name four layers twice, may lack the second decoder, keep a head of the pretraining, or be halves."""
    state = network_of(DPT).state_dict()
    for side in (1, 2):
        for k in range(4):
            name = f"downstream_head{side}.dpt.scratch.layer"
            state[f"{name}_rn.{k}.weight"] = state[f"{name}{k + 1}_rn.weight"]
    state["prediction_head.weight"] = torch.zeros(3, 3)
    state = {name: tensor.half() for name, tensor in state.items() if not name.startswith("dec_blocks2.")}
    loaded = load_network(stored(tmp_path / "net.pth", call(DPT, freeze="'encoder'"), state)).state_dict()
    assert torch.equal(loaded["dec_blocks2.3.cross_attn.projk.weight"], loaded["dec_blocks.3.cross_attn.projk.weight"])
    assert {tensor.dtype for tensor in loaded.values()} == {torch.float32}


class Hostile:
    """Unpickled without care, this makes a file."""

    def __init__(self, mark):
        self.mark = str(mark)

    def __reduce__(self):
        return os.mkdir, (self.mark,)


def test_a_hostile_pickle_is_not_run(tmp_path):
    mark = tmp_path / "ran"
    path = tmp_path / "net.pth"
    for content in ({"args": Hostile(mark), "model": {}}, Hostile(mark)):
        torch.save(content, path)
        assert "no readable checkpoint" in refused(path)
        path.write_bytes(pickle.dumps(content))
        assert "no readable checkpoint" in refused(path)
        assert not mark.exists()
    torch.load(stored(path, Hostile(mark), {}), weights_only=False)
    assert mark.exists()  # the trap was live


@pytest.mark.parametrize(
    ("model", "reason"),
    [
        ("__import__('os').mkdir({mark!r})", "found the model"),
        ("AsymmetricCroCo3DStereo(enc_depth=__import__('os').mkdir({mark!r}))", "code as the value of enc_depth"),
        ("AsymmetricCroCo3DStereo(**dict(enc_depth=2))", "code as the value of None"),
        ("AsymmetricCroCo3DStereo(2, 3)", "with named values"),
        ("AsymmetricCroCo3DStereo(" + "(" * 900 + ")", "expected a constructor call"),
        ("AsymmetricCroCo3DStereo(" + "-" * 3000 + "1)", "expected"),
        ("AsymmetricMASt3R(enc_depth=2)", "found the model 'AsymmetricMASt3R', expected AsymmetricCroCo3DStereo"),
        ("AsymmetricCroCo3DStereo(", "expected a constructor call"),
        ("x" * 5000, "expected a short constructor call"),
        (7, "args.model of type int"),
        (None, "args.model of type NoneType"),
    ],
)
def test_the_call_is_parsed_and_never_run(tmp_path, model, reason):
    mark = tmp_path / "ran"
    model = model.replace("{mark!r}", repr(str(mark))) if isinstance(model, str) else model
    assert reason in refused(stored(tmp_path / "net.pth", model, network_of(LINEAR).state_dict()))
    assert not mark.exists()


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"enc_depth": 3}, "found 2 enc_blocks in the model, expected 3"),
        ({"dec_depth": 10**9}, "found 1 dec_blocks in the model, expected 1000000000"),
        ({"enc_embed_dim": 32}, "patch_embed.proj.weight of shape"),
        ({"enc_embed_dim": 10**12}, "encoder_dim=1000000000000, expected a whole number"),
        ({"enc_num_heads": 3}, "16 channels for 3 heads"),
        ({"enc_num_heads": "True"}, "encoder_heads=True"),
        ({"patch_size": 8}, "of shape"),
        ({"head_type": "'dpt'"}, "no DPT head"),
        ({"head_type": "'catmlp+dpt'"}, "found head_type=catmlp+dpt"),
        ({"conf_mode": "None"}, "found conf_mode=None"),
        ({"depth_mode": "('square', -inf, inf)"}, "found depth_mode"),
        ({"pos_embed": "'cosine'"}, "found pos_embed=cosine"),
        ({"two_confs": "True"}, "found 'two_confs' in args.model"),
    ],
)
def test_sizes_have_to_agree_with_the_tensors(tmp_path, changed, reason):
    path = stored(tmp_path / "net.pth", call(LINEAR, **changed), network_of(LINEAR).state_dict())
    assert reason in refused(path)


def test_other_tensors_are_refused_by_name(tmp_path):
    path = tmp_path / "net.pth"
    state = network_of(LINEAR).state_dict()
    lacking = {name: tensor for name, tensor in state.items() if name != "enc_norm.bias"}
    assert "without enc_norm.bias" in refused(stored(path, call(LINEAR), lacking))
    assert "with head.extra" in refused(stored(path, call(LINEAR), state | {"head.extra": torch.zeros(2)}))
    assert "'enc_norm.bias' in the model" in refused(stored(path, call(LINEAR), state | {"enc_norm.bias": 3}))
    spoilt = state | {"enc_norm.bias": torch.full((16,), torch.nan)}
    assert "NaN or infinity in enc_norm.bias" in refused(stored(path, call(LINEAR), spoilt))
    sparse = state | {"enc_norm.bias": torch.zeros(16).to_sparse()}
    assert "'enc_norm.bias' in the model" in refused(stored(path, call(LINEAR), sparse))


def test_damaged_and_foreign_files_are_refused_in_one_line(tmp_path):
    path = stored(tmp_path / "net.pth", call(LINEAR), network_of(LINEAR).state_dict())
    whole = path.read_bytes()
    for keep in (0, 1, 100, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:keep])
        assert "no readable checkpoint" in refused(path)
    path.write_bytes(b"\x89PNG\r\n" + bytes(1000))
    assert "no readable checkpoint" in refused(path)
    assert "no such file" in refused(tmp_path / "absent.pth")
    assert "no readable checkpoint" in refused(tmp_path)
    for content in ([1, 2], {"model": {}}, {"model": 3, "args": argparse.Namespace()}, torch.zeros(3)):
        buffer = io.BytesIO()
        torch.save(content, buffer)
        path.write_bytes(buffer.getvalue())
        assert "found another kind of file" in refused(path)


def test_flipped_bytes_give_an_error_or_finite_weights(tmp_path):
    path = stored(tmp_path / "net.pth", call(LINEAR), network_of(LINEAR).state_dict())
    whole = bytearray(path.read_bytes())
    generator = torch.Generator().manual_seed(0)
    for place in torch.randint(len(whole), (60,), generator=generator).tolist():
        damaged = whole.copy()
        damaged[place] ^= 0xFF
        path.write_bytes(damaged)
        try:
            network = load_network(path)
        except BadRunError as error:
            assert "\n" not in str(error)  # noqa: PT017
        else:
            assert all(torch.isfinite(tensor).all() for tensor in network.state_dict().values())
