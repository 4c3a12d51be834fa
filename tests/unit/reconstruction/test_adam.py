"""Adam: native against torch's in float64, and its state over a kill."""

import copy
import subprocess
import sys

import pytest
import torch

from reconstruction.errors import ReconstructionError
from reconstruction.training.adam import Adam

SHAPES = [(1,), (7, 3), (64, 4), (1001,)]


def trained(optimizer_of, dtype, steps=12, scale=1.0):
    generator = torch.Generator().manual_seed(0)
    leaves = [torch.randn(shape, generator=generator).to(dtype).requires_grad_() for shape in SHAPES]
    optimizer = optimizer_of([{"params": [leaf], "lr": 1e-2 * (k + 1)} for k, leaf in enumerate(leaves)])
    for step in range(steps):
        for k, leaf in enumerate(leaves):
            gradient = scale * torch.randn(leaf.shape, generator=generator)
            leaf.grad = gradient.to(dtype) if (step + k) % 5 else torch.zeros_like(leaf)
        optimizer.step()
    return leaves, optimizer


def torch_adam(groups):
    return torch.optim.Adam(groups, betas=(0.9, 0.99), eps=1e-15)


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e6])
def test_it_is_adam(scale):
    found, _ = trained(Adam, torch.float32, scale=scale)
    expected, _ = trained(torch_adam, torch.float64, scale=scale)
    for f, e in zip(found, expected, strict=True):
        torch.testing.assert_close(f.double(), e, rtol=1e-5, atol=1e-6)


def test_a_leaf_that_never_had_a_gradient_stays():
    for gradient in (None, torch.zeros(5)):
        leaf = torch.ones(5, requires_grad=True)
        leaf.grad = gradient
        Adam([{"params": [leaf], "lr": 0.1}]).step()
        assert (leaf == 1).all()


def test_a_resumed_training_ends_in_the_same_bits():
    def step(leaf, optimizer, seed):
        leaf.grad = torch.randn(leaf.shape, generator=torch.Generator().manual_seed(seed))
        optimizer.step()

    through = torch.ones(30, 3, requires_grad=True)
    optimizer = Adam([{"params": [through], "lr": 0.1}])
    for seed in range(4):
        step(through, optimizer, seed)
    resumed = through.detach().clone().requires_grad_()
    later = Adam([{"params": [resumed], "lr": 0.5}])
    later.load_state_dict(copy.deepcopy(optimizer.state_dict()))
    for seed in range(4, 9):
        step(through, optimizer, seed)
        step(resumed, later, seed)
    assert (through == resumed).all()


def test_torch_reads_its_state():
    leaves, optimizer = trained(Adam, torch.float32)
    other = torch_adam([{"params": [leaf], "lr": 1e-2} for leaf in leaves])
    other.load_state_dict(optimizer.state_dict())
    assert float(other.state[leaves[1]]["step"]) == 12
    assert (other.state[leaves[1]]["exp_avg"] == optimizer.state[leaves[1]]["exp_avg"]).all()


def test_it_reads_torchs_state():
    leaves, optimizer = trained(torch_adam, torch.float32)
    other = Adam([{"params": [leaf], "lr": 1.0} for leaf in leaves])
    other.load_state_dict(optimizer.state_dict())
    assert [group["lr"] for group in other.param_groups] == [1e-2, 2e-2, 3e-2, 4e-2]
    assert int(other.state[leaves[1]]["step"]) == 12
    for stored in (optimizer.state_dict(), other.state_dict()):
        assert sorted(stored["state"]) == [0, 1, 2, 3]
        assert [group["params"] for group in stored["param_groups"]] == [[0], [1], [2], [3]]


@pytest.mark.parametrize("sizes", [(2, 2), (3,), (1, 2)])
def test_the_state_of_other_groups_is_refused(sizes):
    def groups(sizes):
        return [{"params": [torch.ones(2, requires_grad=True) for _ in range(size)], "lr": 0.1} for size in sizes]

    with pytest.raises(ValueError, match=r"groups|zip"):
        Adam(groups((2, 1))).load_state_dict(Adam(groups(sizes)).state_dict())


def test_gradients_are_forgotten_or_set_to_zero():
    leaf, bare = torch.ones(3, requires_grad=True), torch.ones(2, requires_grad=True)
    optimizer = Adam([{"params": [leaf, bare], "lr": 0.1}])
    leaf.grad = torch.ones(3)
    optimizer.zero_grad(set_to_none=False)
    assert (leaf.grad == 0).all()
    assert bare.grad is None
    optimizer.zero_grad()
    assert leaf.grad is None


def test_torchs_compiler_is_not_imported():
    program = """
import sys, torch
from reconstruction.training.adam import Adam
leaf = torch.ones(3, requires_grad=True)
optimizer = Adam([{"params": [leaf], "lr": 0.1}])
(leaf ** 2).sum().backward()
optimizer.step()
optimizer.zero_grad()
optimizer.load_state_dict(optimizer.state_dict())
print("torch._dynamo" in sys.modules)
"""
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, text=True).stdout == "False\n"


@pytest.mark.parametrize("threads", [1, 3])
def test_the_same_bits_for_any_number_of_threads(threads):
    before = torch.get_num_threads()
    expected, _ = trained(Adam, torch.float32)
    try:
        torch.set_num_threads(threads)
        found, _ = trained(Adam, torch.float32)
    finally:
        torch.set_num_threads(before)
    assert all((f == e).all() for f, e in zip(found, expected, strict=True))


@pytest.mark.parametrize("leaf", [torch.ones(3, dtype=torch.float64), torch.ones(4, 6)[:, ::2]])
def test_other_leaves_are_refused(leaf):
    with pytest.raises(ReconstructionError, match="contiguous float32"):
        Adam([{"params": [leaf.requires_grad_()], "lr": 0.1}])
