"""Tells how much memory this process can still have: what caches files counts, and the limits of its groups hold."""

import os
import re
from pathlib import Path

_V1, _V2 = ("memory.limit_in_bytes", "memory.usage_in_bytes"), ("memory.max", "memory.current")
_CACHED = re.compile(r"^(?:total_)?inactive_file (\d+)$", re.MULTILINE)


def available_bytes(root: Path = Path("/")) -> int:
    """Return the bytes that can be had without swapping, by the kernel's files below `root`."""
    found = re.search(r"^MemAvailable: +(\d+) kB$", _text(root / "proc/meminfo"), re.MULTILINE)
    free = int(found[1]) * 1024 if found else os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return max(0, min([free, *_left_in_groups(root)]))


def _left_in_groups(root: Path) -> list[int]:
    """Return the bytes left in each control group, of either version, that this process is in and that has a limit."""
    left = []
    for line in _text(root / "proc/self/cgroup").splitlines():
        _, controllers, group = line.split(":", 2)
        if controllers not in ("", "memory"):
            continue
        mounted, names = root / "sys/fs/cgroup" / controllers, _V1 if controllers else _V2
        own = mounted / group.lstrip("/")  # a container sees its own group at the top, where it is mounted
        for folder in (own, *own.parents[: len(own.parts) - len(mounted.parts)]):
            limit, used = (_text(folder / name).strip() for name in names)
            if limit.isdecimal() and used.isdecimal():
                cached = _CACHED.findall(_text(folder / "memory.stat"))
                left.append(int(limit) - int(used) + int(cached[-1] if cached else 0))
    return left


def _text(path: Path) -> str:
    """Return a file's text, empty where it cannot be read."""
    try:
        return path.read_text()
    except OSError:
        return ""
