# Everything a person types: `make demo` and `make test` set up what they need.
VENV := .venv
PY := $(VENV)/bin/python
STAMP := $(VENV)/.installed
NATIVE := CMakeLists.txt $(wildcard acquisition/*.cpp acquisition/*/*.cpp acquisition/*.h acquisition/*/*.h reconstruction/*/*.cpp reconstruction/*/*.h)

.PHONY: install demo test test-slow fuzz usbvm check bench sheets serve clean
install: $(STAMP)

$(STAMP): pyproject.toml constraints.txt $(NATIVE)
	test -x $(PY) || python3 -m venv $(VENV)
	$(PY) -m pip install --quiet --constraint constraints.txt --editable '.[reconstruction,server,dev]'
	touch $@

demo: install
	$(VENV)/bin/spike4dgs demo

test: install
	$(PY) -m pytest -m "not slow"

test-slow: install
	$(PY) -m pytest -m slow

fuzz: install
	$(PY) -m pytest --hypothesis-profile fresh -k "fuzz or ten_thousand" -m "not usbvm"

usbvm: install
	SPIKE4DGS_USBVM=tests/contract/qemu.sh $(PY) -m pytest -m usbvm

check: install
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/lint-imports
	$(VENV)/bin/pyright
	$(PY) tests/architecture/audit.py

bench: install
	for name in images pixels poses rasterizer recorder training; do $(VENV)/bin/spike4dgs bench $$name --out tests/benchmarks || exit; done
	$(PY) -m reconstruction.images.learned.train curve reconstruction/images/learned/weights/small.json reconstruction/images/learned/weights/blindspot.json --out tests/benchmarks/learned.png
	$(PY) -m reconstruction.initialization.msdi.train curve reconstruction/initialization/msdi/weights/small.json --out tests/benchmarks/msdi.png

sheets: install
	$(PY) -m reconstruction.bench.sheets --out runs/sheets

serve: install
	$(VENV)/bin/spike4dgs serve --devices mock:fan_and_ball --with-worker

clean:
	rm -rf $(VENV) .build
