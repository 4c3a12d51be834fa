"""The web process serves and never computes: torch and its like stay out of it."""

import json
import subprocess
import sys
from pathlib import Path

SERVE = """
import json, sys
from pathlib import Path
from fastapi.testclient import TestClient
from server.app import create_app
from server.settings import ServiceSettings

with TestClient(create_app(ServiceSettings(data=Path(sys.argv[1]))), base_url="http://127.0.0.1") as http:
    paths = ["/", "/v1/info", "/v1/rigs", "/v1/rigs/lab3x3", "/v1/captures", "/v1/jobs", "/v1/readyz"]
    paths += ["/v1/rigs/lab3x3/status", "/v1/uploads"]
    codes = [http.get(path).status_code for path in paths]
    codes.append(http.post("/v1/rigs/lab3x3/captures", json={"ticks": 20}).status_code)
    codes.append(http.post("/v1/jobs", json={"capture": "c"}).status_code)
print(json.dumps({"codes": codes, "modules": sorted(sys.modules)}))
"""
FORBIDDEN = ("torch", "cv2", "pycolmap", "matplotlib", "av", "usb")


def test_the_web_process_never_loads_torch(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", SERVE, tmp_path / "data"], capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    assert found["codes"] == [200, 200, 200, 200, 200, 200, 503, 200, 200, 202, 422]
    loaded = {name.split(".")[0] for name in found["modules"]}
    assert "dbos" in loaded
    assert loaded.isdisjoint(FORBIDDEN)
    assert "server.work.worker" not in found["modules"]
