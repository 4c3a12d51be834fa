import re
from pathlib import Path

ROOT = Path(__file__).parents[3]


def test_the_image_is_built_by_the_makefile() -> None:
    lines = (ROOT / "docker" / "Dockerfile.cpu").read_text()
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    run = re.findall(r"^RUN make ([\w-]+)", lines, re.MULTILINE)
    command = re.findall(r'^CMD \["make", "([\w-]+)"\]', lines, re.MULTILINE)
    assert run == ["install"]
    assert command == ["serve"]
    assert targets.issuperset(run + command)
    assert not re.search(r"\bpip3? install\b", lines)  # what is installed is said in one place
