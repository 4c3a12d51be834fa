import pytest

from acquisition.errors import BadRecordingError
from acquisition.session import record as record_module
from acquisition.session.memory import available_bytes
from acquisition.session.record import Take, record
from rigs.toml import catalog_rig

GB = 1 << 30


@pytest.fixture
def kernel(tmp_path):
    """A kernel's files: one GB is free, and seven more cache files."""

    def write(name: str, text: str) -> None:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)

    write("proc/meminfo", f"MemTotal: {GB // 64} kB\nMemFree: {GB // 1024} kB\nMemAvailable: {GB // 128} kB\n")
    return write


def test_what_caches_files_is_there_to_be_had(tmp_path, kernel):
    assert available_bytes(tmp_path) == 8 * GB


@pytest.mark.parametrize("group", ["/", "/system.slice/recorder.service"])
def test_the_limit_of_a_group_holds_and_its_cache_counts(tmp_path, kernel, group):
    kernel("proc/self/cgroup", f"0::{group}\n")
    folder = f"sys/fs/cgroup{group}"
    kernel(f"{folder}/memory.max", f"{4 * GB}\n")
    kernel(f"{folder}/memory.current", f"{3 * GB}\n")
    assert available_bytes(tmp_path) == GB
    kernel(f"{folder}/memory.stat", f"anon 1\ninactive_file {2 * GB}\n")
    assert available_bytes(tmp_path) == 3 * GB
    kernel(f"{folder}/memory.max", "max\n")
    assert available_bytes(tmp_path) == 8 * GB


def test_groups_of_the_first_version_hold_too(tmp_path, kernel):
    kernel("proc/self/cgroup", "5:cpu,cpuacct:/\n4:memory:/user/me\n0::/\n")
    kernel("sys/fs/cgroup/memory/user/memory.limit_in_bytes", f"{2 * GB}\n")
    kernel("sys/fs/cgroup/memory/user/memory.usage_in_bytes", f"{GB}\n")
    kernel("sys/fs/cgroup/memory/user/memory.stat", f"inactive_file 1\ntotal_inactive_file {GB // 2}\n")
    assert available_bytes(tmp_path) == 1.5 * GB


def test_this_machine_has_memory():
    assert available_bytes() > 1 << 20


def test_a_pre_trigger_may_take_half_of_what_can_be_had(tmp_path, monkeypatch):
    rig = catalog_rig("lab3x3").scaled(40, 25).only(["cam00"])
    monkeypatch.setattr(record_module, "available_bytes", lambda: 1000)
    with pytest.raises(BadRecordingError, match="pre-trigger of 1250 bytes, expected at most half of the 1000 bytes"):
        record(rig, "mock:flat", Take(None, 0.5), tmp_path / "rec")
