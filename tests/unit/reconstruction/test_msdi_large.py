import argparse

import pytest
import torch

from acquisition.scenes.random.several_views import random_rig
from reconstruction.errors import BadRunError
from reconstruction.networks.dust3r.blocks import Turns
from reconstruction.networks.dust3r.network import Architecture, Dust3r
from reconstruction.networks.msdi.features import CHANNELS
from reconstruction.networks.msdi.large import BackboneTrunk, large_msdi
from reconstruction.networks.msdi.views import Views

TINY = Architecture(32, 2, 2, 24, 2, 3, head="linear")
CALL = (
    "AsymmetricCroCo3DStereo(enc_embed_dim=32, enc_depth=2, enc_num_heads=2, dec_embed_dim=24, dec_depth=2, "
    "dec_num_heads=3, pos_embed='RoPE100', head_type='linear', output_mode='pts3d', depth_mode=('exp', -inf, inf), "
    "conf_mode=('exp', 1, inf))"
)


def seen(views=3, height=32, width=48):
    return torch.rand(views, CHANNELS, height, width, generator=torch.Generator().manual_seed(1)) - 0.5


@torch.no_grad()
def test_the_large_tier_solves_what_the_small_one_does():
    torch.manual_seed(0)
    network, rig = large_msdi(TINY).eval(), random_rig(1, 3, 48, 32)
    solved = network.solve(seen(), Views.of_rig(rig))
    assert solved.encoded.tokens.shape == (3, 24, 96)
    assert solved.adjusted.views.rotation.shape == (3, 3, 3)
    swept = network.sweep(solved.encoded.middle, solved.adjusted.views, 0)
    assert swept.inverse_depth.shape == (32, 48)


@torch.no_grad()
def test_views_in_another_order_give_the_same_tokens_in_that_order():
    torch.manual_seed(0)
    network, order, nominal = large_msdi(TINY).eval(), [2, 0, 3, 1], Views.of_rig(random_rig(1, 4, 48, 32))
    one = network.solve(seen(4), nominal).encoded.tokens
    two = network.solve(seen(4)[order], nominal.select(order)).encoded.tokens
    assert torch.allclose(one[order], two, atol=1e-5)


@torch.no_grad()
def test_the_trunk_is_the_checkpoints_for_two_views(tmp_path):
    """Two views with the second decoder a copy of the first: DUSt3R's own decoding, token by token."""
    torch.manual_seed(2)
    stored = Dust3r(TINY).eval()
    stored.dec_blocks2.load_state_dict(stored.dec_blocks.state_dict())
    path = tmp_path / "backbone.pth"
    torch.save({"args": argparse.Namespace(model=CALL), "model": stored.state_dict()}, path)
    network = large_msdi(backbone=path).eval()
    trunk = network.encoder.trunk
    assert isinstance(trunk, BackboneTrunk)
    trunk.norm = torch.nn.Identity()  # pyright: ignore[reportAttributeAccessIssue]
    pictures = seen(2)
    images = torch.nn.functional.interpolate(pictures[:, :1], size=(64, 96), mode="bilinear").expand(-1, 3, -1, -1)
    encoded = stored.encode(images)
    turns = Turns.of_grid((4, 6), 8, 100.0, encoded)
    expected = stored.decode(encoded[:1], encoded[1:], turns)[0][-1]
    found = trunk(torch.zeros(2, 24, 96), pictures, torch.ones(2, 24, 2, 24, dtype=torch.bool))
    assert torch.allclose(found[:1], trunk.adapt(expected), atol=1e-5)


def test_gradients_reach_the_backbone():
    torch.manual_seed(0)
    network = large_msdi(TINY)
    solved = network.solve(seen(), Views.of_rig(random_rig(1, 3, 48, 32)))
    solved.encoded.fine.square().mean().backward()
    weight = network.encoder.get_parameter("trunk.patch_embed.proj.weight")
    assert weight.grad is not None
    assert float(weight.grad.abs().max()) > 0


def test_another_file_is_no_backbone(tmp_path):
    (tmp_path / "junk.pth").write_bytes(b"junk")
    with pytest.raises(BadRunError, match="no readable checkpoint"):
        large_msdi(backbone=tmp_path / "junk.pth")
