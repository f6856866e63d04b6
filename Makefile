# Everything starts here: `make` lists the targets, and each of them first sets up what it needs.
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help setup build gpu lock lint format test test-data gpu-test cluster-test reproduce ablations bench work-precision stability numerics report sanitize fuzz clean

PYTHON ?= $(or $(shell command -v python3.11 || command -v python3),python3)
RUN := .venv/bin/python -m
RUNS ?= results/runs
FUZZ_SECONDS ?= 20
CPP := $(wildcard rasterizer/src/*.?pp rasterizer/src/*/*.hpp)
MARKDOWN := README.md CONTRIBUTING.md CHANGELOG.md docs results/measured/motion results/measured/dnerf pipeline/studies

# How long a target took since make began, what it set up on the way included.
STARTED := $(shell date +%s)
took = s=$$(( $$(date +%s) - $(STARTED) )); echo "make $@: $(1) in $$(( s / 60 )) min $$(( s % 60 )) s, set-up included"

# The viewer's JavaScript: Biome checks and formats it. npm installs it in build/, where there is an npm.
JAVASCRIPT := build/javascript
biome = if command -v npm > /dev/null; then \
	if ! cmp -s tools/javascript/package.json $(JAVASCRIPT)/package.json; then \
		mkdir -p $(JAVASCRIPT) && cp tools/javascript/package.json $(JAVASCRIPT) && \
		(cd $(JAVASCRIPT) && npm install --silent --no-package-lock --no-audit --no-fund) || \
		{ rm -f $(JAVASCRIPT)/package.json; exit 1; }; fi; \
	echo "biome $(1) pipeline/view/page" && $(JAVASCRIPT)/node_modules/.bin/biome $(1) --config-path=tools/javascript pipeline/view/page; \
	else echo "lint: npm is not installed, so the viewer's JavaScript is not checked"; fi

# What make compares to decide whether there is work: packages after the lock, kernel after its sources. Packages are
# installed while the kernel compiles. That is the kernel of this machine's best instruction set; what compares
# instruction sets needs ALL_KERNELS.
MAKEFLAGS += --jobs=2
TOOLS := .venv/.tools
INSTALLED := .venv/.installed
BUILT := build/.built
ALL_KERNELS := build/.all_kernels
KERNEL_SOURCES := CMakeLists.txt $(CPP)

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-14s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(BUILT) ## make .venv, install what requirements.lock pins, build the kernel

build: $(BUILT) ## rebuild the kernel if its sources changed

gpu: $(BUILT) ## put PyTorch with CUDA and gsplat into .venv, for backend=gsplat (docs/gpu.md)
	@"$(PYTHON)" tools/setup_environment.py gpu

lock: ## renew requirements.lock after a change of pyproject.toml; UPGRADE=--upgrade takes the newest versions
	@"$(PYTHON)" tools/lock.py $(UPGRADE)

lint: $(INSTALLED) ## check style, imports, types, C++, Markdown and, where npm is installed, JavaScript; changes nothing
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/mypy
	.venv/bin/clang-format --dry-run -Werror $(CPP)
	.venv/bin/mdformat --check $(MARKDOWN)
	@$(call biome,ci)

format: $(INSTALLED) ## format Python, imports, C++, Markdown and JavaScript
	.venv/bin/ruff check --fix --select I .
	.venv/bin/ruff format .
	.venv/bin/clang-format -i $(CPP)
	.venv/bin/mdformat $(MARKDOWN)
	@$(call biome,check --write)

test: $(ALL_KERNELS) ## run all tests
	$(RUN) pytest -n auto --dist loadscope --no-loadscope-reorder
	@$(call took,passed)

test-data: $(BUILT) ## the tests that need real data: DATA_DIR=/path holds dnerf/lego and photographs
	$(RUN) pytest -m data tests/real_data
	@$(call took,passed)

cluster-test: $(BUILT) build/cluster/.installed ## sweeps on a real Slurm (apt-get install slurm-wlm munge), Ray and HyperQueue of this machine
	$(RUN) pytest -m cluster tests/cluster
	@$(call took,passed)

gpu-test: $(BUILT) ## check, train and time on a GPU, at most six minutes; needs make gpu
	@PYTHONPATH=tests:tests/helpers $(RUN) gpu

reproduce: $(BUILT) ## train the synthetic suite, and each ablation on the scene made for it; write tables, plots, report
	$(RUN) pipeline experiment=reproduce
	$(RUN) pipeline.report results/runs
	@echo "make reproduce: the report is results/report/report.html"
	@$(call took,done)

ablations: $(BUILT) ## all ablations on all dynamic synthetic scenes, beside the runs of reproduce
	$(RUN) pipeline experiment=synthetic_ablation
	$(RUN) pipeline.report results/runs
	@echo "make ablations: the report is results/report/report.html"
	@$(call took,done)

bench: $(ALL_KERNELS) ## time kernel, loss, optimiser and reference implementation in one run; a roofline plot in results/bench
	@mkdir -p results/bench
	$(RUN) rasterizer.bench W1 W2h W2 --all > results/bench/bench.txt; status=$$?; cat results/bench/bench.txt; exit $$status

work-precision: $(BUILT) ## error against time of the kernel's numerical choices: results/kernel_precision
	$(RUN) pipeline.studies.kernel_precision

stability: $(ALL_KERNELS) ## float32 kernel against float64 in ill-conditioned scenes: results/kernel_stability; fails above a bound
	$(RUN) pipeline.studies.kernel_stability

numerics: $(ALL_KERNELS) ## stability, work-precision and bench one after another; stores their results beside the studies
	@$(MAKE) --no-print-directory stability
	@$(MAKE) --no-print-directory work-precision
	@$(MAKE) --no-print-directory bench
	$(RUN) pipeline.studies.stored
	.venv/bin/mdformat pipeline/studies/kernel_stability/results.md pipeline/studies/kernel_precision/results.md

report: $(BUILT) ## tables, plots and the HTML page from the run folders under RUNS=results/runs
	$(RUN) pipeline.report "$(RUNS)"

sanitize: $(ALL_KERNELS) ## the kernel's tests with every memory access and operation checked
	.venv/bin/python tools/sanitize.py

fuzz: $(BUILT) ## fuzz every reader with damaged files and rasterize with odd arguments: FUZZ_SECONDS=20 each; fails if a rule breaks
	PYTHONPATH=tests:tests/helpers $(RUN) fuzz all --seconds $(FUZZ_SECONDS)

clean: ## remove the built kernel and caches; .venv and results stay
	rm -rf build rasterizer/*.so .pytest_cache .hypothesis .mypy_cache .ruff_cache
	find . -name __pycache__ -not -path './.venv/*' -prune -exec rm -rf {} +

$(TOOLS): pyproject.toml requirements.lock tools/setup_environment.py
	@"$(PYTHON)" tools/setup_environment.py tools
	@touch $@

$(INSTALLED): $(TOOLS)
	@"$(PYTHON)" tools/setup_environment.py packages
	@touch $@

# Ray and HyperQueue, in front of the packages of .venv.
build/cluster/.installed: $(INSTALLED) tests/cluster/requirements.txt
	@.venv/bin/python -m venv build/cluster
	@cd build/cluster/lib/python*/site-packages && \
		echo "import site; site.addsitedir('$$(ls -d $(CURDIR)/.venv/lib/python*/site-packages)')" > locked.pth
	@build/cluster/bin/python -m pip install --quiet --disable-pip-version-check -r tests/cluster/requirements.txt
	@touch $@

# The project itself, editable. No build isolation, which would fetch a second set of tools for every build. Ninja is
# not told of make's jobs: it may take both cores.
build/build.ninja: $(TOOLS)
	@echo "setup: compiling the kernel"
	@MAKEFLAGS= PATH="$(CURDIR)/.venv/bin:$$PATH" .venv/bin/pip install --quiet --no-build-isolation --no-deps --editable .
	@touch $@

$(BUILT): build/build.ninja $(INSTALLED) $(KERNEL_SOURCES)
	@MAKEFLAGS= PATH="$(CURDIR)/.venv/bin:$$PATH" cmake --build build --target all $(if $(wildcard $(ALL_KERNELS)),other_kernels)
	@touch $@

$(ALL_KERNELS): $(BUILT)
	@echo "compiling the kernel for this machine's other instruction sets"
	@MAKEFLAGS= PATH="$(CURDIR)/.venv/bin:$$PATH" cmake --build build --target other_kernels
	@touch $@
