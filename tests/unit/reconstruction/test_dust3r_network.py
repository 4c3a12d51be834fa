import math

import pytest
import torch

from reconstruction.errors import BadRunError
from reconstruction.networks.dust3r.blocks import Attention, CrossAttention, DecoderBlock, Turns
from reconstruction.networks.dust3r.heads import DptSizes, LinearHead
from reconstruction.networks.dust3r.network import Architecture, Dust3r, unfolded

SMALL = Architecture(
    encoder_dim=32,
    encoder_depth=2,
    encoder_heads=2,
    decoder_dim=24,
    decoder_depth=4,
    decoder_heads=3,
    dpt=DptSizes((4, 6, 8, 10), fused=8, last=6),
)
LINEAR = Architecture(32, 2, 2, 24, 4, 3, head="linear")


def drawn(architecture, seed=0):
    torch.manual_seed(seed)
    return Dust3r(architecture).eval()


def images(count=2, height=48, width=80):
    return torch.rand(count, 3, height, width, generator=torch.Generator().manual_seed(1)) * 2 - 1


def spelt_out_turn(vector, row, column, base):
    """One head's channels as complex numbers times exp(i angle): first half by the row, second by the column."""
    turned = vector.clone()
    quarter = len(vector) // 4
    for start, place in ((0, row), (2 * quarter, column)):
        for k in range(quarter):
            angle = place * base ** (-k / quarter)
            number = complex(vector[start + k], vector[start + k + quarter]) * complex(math.cos(angle), math.sin(angle))
            turned[start + k], turned[start + k + quarter] = number.real, number.imag
    return turned


def spelt_out_attention(query, key, value):
    """[n, d], [m, d], [m, d]: softmax(q k / sqrt d) v, one query at a time."""
    rows = []
    for q in query:
        weights = torch.softmax(torch.stack([q @ k for k in key]) / math.sqrt(len(q)), dim=0)
        rows.append(sum(w * v for w, v in zip(weights, value, strict=True)))
    return torch.stack(rows)


def test_turns_are_complex_rotations_by_row_and_column():
    like = torch.zeros((), dtype=torch.float64)
    turns = Turns.of_grid((2, 3), 16, 100.0, like)
    tokens = torch.rand(1, 1, 6, 16, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    found = turns.apply(tokens)[0, 0]
    for n in range(6):
        expected = spelt_out_turn(tokens[0, 0, n], n // 3, n % 3, 100.0)
        assert torch.allclose(found[n], expected, atol=1e-6)


def test_what_two_tokens_make_of_each_other_depends_on_how_far_apart_they_lie():
    turns = Turns.of_grid((4, 5), 8, 100.0, torch.zeros(()))
    query, key = torch.rand(2, 8, generator=torch.Generator().manual_seed(3))
    queries, keys = (turns.apply(v.expand(1, 1, 20, 8))[0, 0] for v in (query, key))
    products = (queries @ keys.T).view(4, 5, 4, 5)
    assert float(products[0, 0, 1, 2]) == pytest.approx(float(products[2, 1, 3, 3]), abs=1e-5)
    assert abs(products[0, 0, 1, 2] - products[0, 0, 2, 1]) > 1e-3


@torch.no_grad()
def test_attention_is_what_the_formula_says():
    torch.manual_seed(4)
    attention, cross = Attention(16, 2).double(), CrossAttention(16, 2).double()
    tokens, other = torch.randn(2, 6, 16, dtype=torch.float64)
    turns = Turns.of_grid((2, 3), 8, 100.0, tokens)

    def turned(rows):
        return torch.stack([spelt_out_turn(row, n // 3, n % 3, 100.0) for n, row in enumerate(rows)])

    query, key, value = attention.qkv(tokens).split(16, dim=-1)
    heads = [slice(0, 8), slice(8, 16)]
    spelt = torch.cat([spelt_out_attention(turned(query[:, h]), turned(key[:, h]), value[:, h]) for h in heads], dim=-1)
    assert torch.allclose(attention(tokens[None], turns)[0], attention.proj(spelt), atol=1e-6)

    query, key, value = cross.projq(tokens), cross.projk(other), cross.projv(other)
    spelt = torch.cat([spelt_out_attention(turned(query[:, h]), turned(key[:, h]), value[:, h]) for h in heads], dim=-1)
    assert torch.allclose(cross(tokens[None], other[None], turns, turns)[0], cross.proj(spelt), atol=1e-6)


def test_a_decoder_block_norms_what_it_looks_at():
    torch.manual_seed(5)
    block = DecoderBlock(16, 2).double()
    tokens, other = torch.randn(2, 1, 6, 16, dtype=torch.float64)
    turns = Turns.of_grid((2, 3), 8, 100.0, tokens)
    found = block(tokens, other, turns, turns)
    assert torch.allclose(found, block(tokens, 5 * other + 3, turns, turns), atol=1e-5)  # a layer norm undoes both
    assert not torch.allclose(found, block(tokens, other.flip(1), turns, turns), atol=1e-3)


def test_parameters_carry_the_names_of_the_public_checkpoints():
    names = {name.removesuffix(".weight") for name in drawn(SMALL).state_dict() if name.endswith(".weight")}
    norms = ["norm1", "norm2"]
    block = [*norms, "attn.qkv", "attn.proj", "mlp.fc1", "mlp.fc2"]
    cross = [*block, "norm3", "norm_y", *(f"cross_attn.{p}" for p in ("projq", "projk", "projv", "proj"))]
    units = [f"resConfUnit{u}.conv{c}" for u in (1, 2) for c in (1, 2)]
    dpt = [
        *("act_postprocess.0.0", "act_postprocess.0.1", "act_postprocess.1.0", "act_postprocess.1.1"),
        *("act_postprocess.2.0", "act_postprocess.3.0", "act_postprocess.3.1", "head.0", "head.2", "head.4"),
        *(f"scratch.layer{k}_rn" for k in (1, 2, 3, 4)),
        *(f"scratch.refinenet{k}.{part}" for k in (1, 2, 3, 4) for part in (*units, "out_conv")),
    ]
    expected = {
        *("patch_embed.proj", "enc_norm", "decoder_embed", "dec_norm"),
        *(f"enc_blocks.{n}.{part}" for n in range(2) for part in block),
        *(f"{blocks}.{n}.{part}" for blocks in ("dec_blocks", "dec_blocks2") for n in range(4) for part in cross),
        *(f"downstream_head{k}.dpt.{part}" for k in (1, 2) for part in dpt),
    }
    assert names == expected
    assert "mask_token" in drawn(SMALL).state_dict()
    assert "downstream_head2.proj.weight" in drawn(LINEAR).state_dict()


@pytest.mark.parametrize("architecture", [SMALL, LINEAR], ids=["dpt", "linear"])
def test_equal_decoders_see_a_pair_the_same_from_either_side(architecture):
    network = drawn(architecture)
    network.dec_blocks2.load_state_dict(network.dec_blocks.state_dict())
    network.downstream_head2.load_state_dict(network.downstream_head1.state_dict())
    pictures = images()
    tokens, grid = network.encode(pictures), network.grid(pictures)
    with torch.no_grad():
        here, _ = network(tokens[:1], tokens[1:], grid)
        _, there = network(tokens[1:], tokens[:1], grid)
    assert here.points.shape == (1, 48, 80, 3)
    assert here.confidence.shape == (1, 48, 80)
    assert torch.allclose(here.points, there.points, atol=1e-5)
    assert here.points.std() > 0
    assert (here.confidence >= 1).all()


def test_both_decoders_and_the_other_image_matter():
    network = drawn(SMALL)
    pictures = images(3)
    grid = network.grid(pictures)
    with torch.no_grad():
        a, b, c = network.encode(pictures).split(1)
        one, two = network(a, b, grid)
        assert not torch.allclose(one.points, two.points, atol=1e-3)
        assert not torch.allclose(one.points, network(a, c, grid)[0].points, atol=1e-4)


def test_a_batch_of_pairs_is_the_pairs_one_by_one():
    network = drawn(SMALL)
    pictures = images(3)
    grid = network.grid(pictures)
    with torch.no_grad():
        tokens = network.encode(pictures)
        together = network(tokens[:2], tokens[1:], grid)[1].points
        alone = [network(tokens[k : k + 1], tokens[k + 1 : k + 2], grid)[1].points[0] for k in range(2)]
    assert torch.allclose(together, torch.stack(alone), atol=1e-5)


def test_a_linear_head_puts_each_number_on_its_pixel():
    torch.manual_seed(6)
    head = LinearHead(8, 4)
    tokens = torch.randn(1, 6, 8)
    outputs = head([tokens], (2, 3))
    assert outputs.shape == (1, 4, 8, 12)
    numbers = head.proj(tokens)[0].view(6, 4, 4, 4)  # token, output, row and column in the patch
    assert outputs[0, 2, 4 + 3, 8 + 1] == numbers[5, 2, 3, 1]


def test_points_lie_expm1_of_the_norm_away_and_nothing_overflows():
    outputs = torch.tensor([[0.3, -0.4, 1.2, 0.7], [0.0, 0.0, 0.0, -50.0], [0.0, 300.0, 400.0, 500.0]])
    points, confidence = unfolded(outputs.T.reshape(1, 4, 1, 3))
    expected = torch.tensor([0.3, -0.4, 1.2]) / 1.3 * math.expm1(1.3)
    assert torch.allclose(points[0, 0, 0], expected, rtol=1e-5)
    assert confidence[0, 0, 0] == pytest.approx(1 + math.exp(0.7))
    assert points[0, 0, 1].tolist() == [0.0, 0.0, 0.0]
    assert confidence[0, 0, 1] == 1
    assert torch.isfinite(points).all()
    assert torch.isfinite(confidence).all()
    assert torch.allclose(points[0, 0, 2] / points[0, 0, 2].norm(), torch.tensor([0.0, 0.6, 0.8]))


def test_sizes_that_do_not_fit_are_refused():
    with pytest.raises(BadRunError, match=r"30 channels for 2 heads, expected a multiple of 8"):
        Architecture(encoder_dim=30, encoder_heads=2)
    with pytest.raises(BadRunError, match=r"encoder_depth=0, expected a whole number"):
        Architecture(encoder_depth=0)
    with pytest.raises(BadRunError, match=r"3 decoder blocks"):
        Architecture(decoder_depth=3)
    with pytest.raises(BadRunError, match=r"80x50, expected multiples of 16; pad them"):
        drawn(LINEAR).encode(images(height=50))
