"""`make check`: does an advisory speak of what is installed?

Runs pip-audit over the environment. 1 for an advisory that audit.toml does not excuse, 0 otherwise; where the advisory
service cannot be reached, or knows none of our packages, that is said and nothing is claimed.
"""

import json
import subprocess
import sys
import tomllib
from pathlib import Path

IGNORED = Path(__file__).with_name("audit.toml")
COMMAND = [sys.executable, "-m", "pip_audit", "--format", "json", "--progress-spinner", "off", "--skip-editable"]
UNREACHED = ("ConnectionError", "Timeout", "ServiceError", "Could not resolve", "Failed to resolve", "Max retries")


def judged(code: int, out: str, err: str, ignored: dict[str, str]) -> tuple[int, list[str]]:
    """Exit status and lines to show, of what pip-audit said."""
    try:
        packages = json.loads(out)["dependencies"]
    except (ValueError, KeyError):
        last = (err.strip().splitlines() or ["nothing"])[-1]
        if any(word in err for word in UNREACHED):
            return 0, [f"audit: NOT DONE, the advisory service was not reached ({last[:160]})"]
        return 1, [f"audit: pip-audit ended with {code}: {last[:300]}"]
    audited = [package for package in packages if "vulns" in package]
    if not audited:
        return 0, [f"audit: NOT DONE, the advisory service answers for none of {len(packages)} packages"]
    found = [(package, flaw) for package in audited for flaw in package["vulns"]]
    names = {name for _, flaw in found for name in (flaw["id"], *flaw.get("aliases", []))}
    open_flaws = [(p, flaw) for p, flaw in found if not {flaw["id"], *flaw.get("aliases", [])} & set(ignored)]
    lines = [
        f"audit: {p['name']} {p['version']}: {flaw['id']}, mended in {', '.join(flaw['fix_versions']) or 'no version'}"
        for p, flaw in open_flaws
    ]
    lines += [
        f"audit: {name} is excused in audit.toml and no longer found; take it out" for name in ignored.keys() - names
    ]
    lines.append(
        f"audit: {len(audited)} packages, {len(packages) - len(audited)} the service does not know, "
        f"{len(found)} advisories, {len(found) - len(open_flaws)} excused"
    )
    return int(bool(open_flaws)), lines


def main() -> None:
    ignored = tomllib.loads(IGNORED.read_text())["ignored"]
    done = subprocess.run(COMMAND, capture_output=True, text=True, check=False)
    code, lines = judged(done.returncode, done.stdout, done.stderr, ignored)
    sys.stdout.write("\n".join(lines) + "\n")
    sys.exit(code)


if __name__ == "__main__":
    main()
