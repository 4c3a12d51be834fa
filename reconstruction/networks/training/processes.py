"""Several processes that train one network, as torchrun starts them: each has its batches, all have the same weights.

`torchrun --nproc-per-node N -m ...` sets WORLD_SIZE, RANK and LOCAL_RANK; with a WORLD_SIZE of 1, or without, nothing
here does anything. Gradients are averaged, so N processes are a batch of N.
"""

import os
from collections.abc import Iterable

import torch
from torch import distributed, nn


def start(device: str) -> str:
    """Join the other processes, if there are any, and return the device of this one."""
    if int(os.environ.get("WORLD_SIZE", "1")) < 2:
        return device
    if device == "cuda":
        device = f"cuda:{os.environ.get('LOCAL_RANK', '0')}"
        torch.cuda.set_device(device)
    distributed.init_process_group("gloo" if device == "cpu" else "nccl")
    return device


def stop() -> None:
    """Leave the others."""
    if distributed.is_initialized():
        distributed.destroy_process_group()


def first() -> bool:
    """Return whether this process scores and stores."""
    return not distributed.is_initialized() or distributed.get_rank() == 0


def own(step: int) -> int:
    """Return the number of this process's batch at `step`."""
    return step * distributed.get_world_size() + distributed.get_rank() if distributed.is_initialized() else step


def step_of(number: int) -> int:
    """Return the step at which some process has batch `number`."""
    return number // distributed.get_world_size() if distributed.is_initialized() else number


def wait() -> None:
    """Wait until all processes are here."""
    if distributed.is_initialized():
        distributed.barrier()


def average_gradients(parameters: Iterable[nn.Parameter]) -> None:
    """Give every process the mean gradient; one that has none counts as zero."""
    if not distributed.is_initialized():
        return
    for parameter in parameters:
        if parameter.grad is None:
            parameter.grad = torch.zeros_like(parameter)
        distributed.all_reduce(parameter.grad)
        parameter.grad /= distributed.get_world_size()
