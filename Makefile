# SPDX-License-Identifier: GPL-3.0-or-later
# Every chore; each sets up what it needs first. `make help` lists them. What the documentation's figures and pictures are
# made by, and tests that take longer than these, are in evidence/Makefile.
.PHONY: help setup build modules module quick test demo format lint stubs golden wheels extension repository sdist playground site \
	version clean

started := $(shell date +%s)
# Evaluated when a recipe runs, after `setup`.
python = $(firstword $(shell ls -d .venv/3.*/bin/python))
tools = $(CURDIR)/$(dir $(python))
pythons = $(shell ls -d $(CURDIR)/.venv/3.*/bin/python | paste -sd';')
jobs ?= $(shell nproc)
build = build/cmake
before_wheels = $(if $(filter native,$(platforms)),modules,setup)
before_packing = $(if $(or $(filter native,$(platforms)),$(wildcard dist/wheels/dynamorph-*.whl)),$(before_wheels),wheels)
c_sources = $(shell find cpp site/playground tests/cpp evidence -name '*.[ch]pp')
workflows = $(wildcard .github/workflows/*.yml) examples/farm/github_actions.yml
define configure
@mkdir -p build
@$(tools)cmake -S . -B $(build) -G Ninja -DCMAKE_MAKE_PROGRAM=$(tools)ninja -DDYNAMORPH_TESTS=ON \
	-DDYNAMORPH_PYTHONS="$(pythons)" --log-level=WARNING >build/configure.log || { cat build/configure.log; exit 1; }
endef
compile = $(python) tools/compile.py $(jobs) "$(filter-out build modules module,$(MAKECMDGOALS))"
# numpy.bool: the same stub with NumPy 1, which has no such name.
stubgen = for module in _core _mesher; do $(python) -W ignore tools/stubs.py dynamorph.$$module --exit-code \
	--enum-class-locations '.*:dynamorph._core' --ignore-unresolved-names 'numpy\.bool' -o $(1) || exit 1; done

# What can be made; `make -C evidence help` lists what makes the pages.
help:
	@awk -f tools/help.awk Makefile

# The packages and Python environments that the rest needs, in .venv.
setup:
	@tools/setup.sh

# The engine, its C++ tests, and its modules for each Python in .venv.
build: setup
	$(configure)
	@$(compile)

# The same without the C++ tests.
modules: setup
	$(configure)
	@$(compile) $(patsubst .venv/%/bin/python,core_%,$(wildcard .venv/3.*/bin/python))

# The same for the first Python alone, which is all that the demo needs.
module: setup
	$(configure)
	@$(compile) core_$(word 2,$(subst /, ,$(python)))

# Whether a change is right, in two to three minutes: lint, and under one
# Python all tests but slow ones of files that have not changed.
quick: lint
	@$(python) tools/run_tests.py --quick

# All tests under the first Python in .venv, and under the others what
# depends on Blender: what a change must pass.
test: build
	@status=0; $(python) tools/run_tests.py || status=$$?; \
	echo "make $(MAKECMDGOALS) took $$((($$(date +%s) - $(started) + 30) / 60)) min"; exit $$status

# Bakes sample_blends/bulging_cylinder.blend; a picture and a loop of it
# are in out/.
demo: module
	@$(python) sample_blends/demo.py

# Formats the sources, and fixes what the linter can.
format: setup
	@$(tools)ruff check --quiet --fix .
	@$(tools)ruff format --quiet .
	@$(tools)clang-format -i $(c_sources)

# Style, formatting, types, workflows, subjects of commits, and whether
# the stubs fit the compiled modules.
lint: build
	@git log --since=2026-11-29T07:00Z --format=%s 2>/dev/null | awk 'length > 72 { bad = 1; \
		print "lint: the subject of a commit has more than 72 characters: " $$0 } END { exit bad }'
	@$(tools)ruff check --quiet .
	@$(tools)ruff format --quiet --check .
	@$(tools)clang-format --dry-run -Werror $(c_sources)
	@if [ -x .venv/3.11/bin/mypy ]; then .venv/3.11/bin/mypy --no-error-summary; \
	else echo 'lint: types are not checked, which needs Python 3.11'; fi
	@$(tools)check-jsonschema --quiet --builtin-schema vendor.github-workflows $(workflows)
	@$(tools)check-jsonschema --quiet --builtin-schema vendor.github-issue-forms .github/ISSUE_TEMPLATE/*_*.yml
	@$(tools)check-jsonschema --quiet --builtin-schema vendor.github-issue-config .github/ISSUE_TEMPLATE/config.yml
	@$(tools)zizmor --quiet --no-progress --offline $(workflows) >build/zizmor.log || { cat build/zizmor.log; exit 1; }
	@$(call stubgen,build/stubs)
	@for stub in _core.pyi _mesher.pyi; do diff -u cpp/bindings/dynamorph/$$stub build/stubs/dynamorph/$$stub || \
		{ echo 'Run make stubs.'; exit 1; }; done

# The stubs of the engine's modules, as they are compiled now.
stubs: build
	@$(call stubgen,cpp/bindings)

# After a change of the motion that is meant: the bytes that the engine
# computes, of every compiler and instruction set that runs here, in
# tests/golden, with a model file of this version until one is released.
golden: build
	@PYTHONPATH=addon:tests $(python) tests/golden/kept_model.py
	@$(python) tests/golden/motion.py

# Wheels of engine and add-on for every system, in dist/wheels; an hour
# the first time. platforms="linux-x64 windows-x64" makes those alone,
# platforms=native one for this machine, in dist.
platforms ?=
wheels: $(before_wheels)
ifeq ($(platforms),native)
	@$(python) tools/package.py wheel
else
	@tools/setup.sh wheels
	@.venv/wheels/bin/python tools/wheels.py $(if $(platforms),--platforms $(platforms))
endif

# The Blender extension in dist: a zip for each platform of the wheels,
# which it makes where there are none, and one for all. platforms=...
extension: $(before_packing)
	@$(python) tools/package.py extension $(platforms)

# Such zips with the index that Blender's Get Extensions reads, in
# dist/repository, for any web server. platforms=...
repository: $(before_packing)
	@$(python) tools/package.py repository $(platforms)

# The engine's sources in dist, with TetGen's, for pip on any system.
sdist: setup
	@mkdir -p build dist
	@$(python) -c 'from scikit_build_core.build import build_sdist; print("dist/" + build_sdist("dist"))' \
		>build/sdist.log 2>&1 || { cat build/sdist.log; exit 1; }
	@tail -n 1 build/sdist.log

# The engine as WebAssembly and the page around it, in build/playground.
playground: module
	@tools/setup.sh site
	@$(python) tools/playground.py

# The website in build/site/html; serve=1 also serves it to this machine.
serve ?=
site: playground
	@.venv/site/bin/python tools/site.py $(if $(serve),--serve)

# The version. new=0.2.0 opens that one in CHANGELOG.md, or dates it.
new ?=
version:
	@python3 tools/version.py $(new)

# Removes what was built; .venv stays.
clean:
	@rm -rf build dist
