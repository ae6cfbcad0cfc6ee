# SPDX-License-Identifier: GPL-3.0-or-later
# Every chore; each sets up what it needs first. `make help` lists them.
.PHONY: help setup build modules module quick test gui-test demo gallery figures materials bench bench-docs robustness believable \
	believable-docs convergence accuracy bakes farm-demo golden fuzz soak faults coverage sanitize stubs format lint wheels \
	platforms extension repository sdist version reliability feels limit collision rigs recipes reference how-long comparison playground site clean

started := $(shell date +%s)
# Evaluated when a recipe runs, after `setup`.
python = $(firstword $(shell ls -d .venv/3.*/bin/python))
newest = $(lastword $(sort $(wildcard .venv/3.*/bin/python))) # of Blender too
tools = $(CURDIR)/$(dir $(python))
pythons = $(shell ls -d $(CURDIR)/.venv/3.*/bin/python | paste -sd';')
jobs ?= $(shell nproc)
build = build/cmake
before_wheels = $(if $(filter native,$(platforms)),modules,setup)
before_packing = $(if $(or $(filter native,$(platforms)),$(wildcard dist/wheels/dynamorph-*.whl)),$(before_wheels),wheels)
c_sources = $(shell find cpp web tests/cpp tests/benchmarks -name '*.[ch]pp')
workflows = $(wildcard .github/workflows/*.yml) farm/github_actions.yml
define configure
@mkdir -p build
@$(tools)cmake -S . -B $(build) -G Ninja -DCMAKE_MAKE_PROGRAM=$(tools)ninja -DDYNAMORPH_TESTS=ON \
	-DDYNAMORPH_PYTHONS="$(pythons)" --log-level=WARNING >build/configure.log || { cat build/configure.log; exit 1; }
endef
compile = $(python) tools/compile.py $(jobs) "$(filter-out build modules module,$(MAKECMDGOALS))"
# numpy.bool: the same stub with NumPy 1, which has no such name.
stubgen = $(python) -W ignore -m pybind11_stubgen dynamorph._core --exit-code \
	--enum-class-locations '.*:dynamorph._core' --ignore-unresolved-names 'numpy\.bool'

# What can be made: each target with the comment above it.
help:
	@awk '/^# / { text = text "    " substr($$0, 3) "\n" } \
		/^[a-z-]+:/ { printf "make %s\n%s", substr($$0, 1, index($$0, ":") - 1), text } \
		!/^#|\?=/ { text = "" }' Makefile

# The packages and the Python environments that the rest needs, in .venv. More is in groups: see tools/setup.sh.
setup:
	@tools/setup.sh

# The engine with its C++ tests, and its Python module for every Python in .venv.
build: setup
	$(configure)
	@$(compile)

# The engine's Python module for every Python in .venv, without the C++ tests.
modules: setup
	$(configure)
	@$(compile) $(patsubst .venv/%/bin/python,core_%,$(wildcard .venv/3.*/bin/python))

# The same for the first Python in .venv, which is all that the demo needs.
module: setup
	$(configure)
	@$(compile) core_$(word 2,$(subst /, ,$(python)))

# Whether a change is right, in two to three minutes: lint, and all tests under one Python but the slow ones; of the files
# that have changed, those too. It says what it leaves to `make test`.
quick: lint
	@$(python) tools/run_tests.py --quick

# All tests under every Python in .venv. A change must pass `make lint test`, which says at its end how long it took.
test: build
	@status=0; $(python) tools/run_tests.py || status=$$?; \
	echo "make $(MAKECMDGOALS) took $$((($$(date +%s) - $(started) + 30) / 60)) min"; exit $$status

# The interface in a real Blender window, set up in build/gui on first use; skips where that cannot be done.
# parts="judging files" repeats only these parts, from what the last run has left.
gui-test: build
	@tools/setup.sh wheels
	@$(python) tools/gui_test.py $(parts)

# Bakes sample_blends/bulging_cylinder.blend, and renders a picture and a loop of it to out/.
demo: module
	@$(python) sample_blends/demo.py

# docs/gallery.md with its moving pictures, among them the README's, and each scene's .blend in dist/gallery; takes about
# 10 minutes. only="Husky" films those that begin so. The page itself also needs the characters of ../shared.
gallery: build
	@$(python) tests/benchmarks/gallery.py --only "$(only)"

# The .blend files of docs/recipes in dist/recipes, before and after the steps, and the pictures and tables of the pages;
# takes about 5 minutes. only="jiggle" makes that one.
recipes: build
	@$(python) sample_blends/recipes/book.py $(only)

# The tables of docs/command_line.md and docs/scripting.md, from the parser and from Blender's data; needs Python 3.13.
reference: build
	@$(newest) tools/reference.py

# docs/results.md with its pictures; takes about 20 minutes.
figures: build
	@$(python) sample_blends/figures.py

# The table of presets in docs/materials.md.
materials: build
	@PYTHONPATH=addon $(python) -m dynamic_morph_targets.core.material.presets docs/materials.md
	@$(python) tools/measured.py docs/materials.md

# Keeps the bytes that the engine computes in this version, of every compiler and instruction set that runs here, in
# tests/golden/motion.json: after a change of the motion that is meant. `make platforms` compiles more of them.
# It also writes tests/golden/model.dynamorph, a model file of the current format, until the first release freezes that.
golden: build
	@PYTHONPATH=addon:tests $(python) tests/golden/kept_model.py
	@$(python) tests/golden/motion.py

# What the engine, the pipeline and the first click take, against their goals; takes about 7 minutes. before=FOLDER, a
# checkout of another commit that is built, measures its clicks too.
bench: build
	@tools/setup.sh bench
	@$(tools)cmake $(build) -DDYNAMORPH_BENCHMARKS=ON --log-level=WARNING >build/configure.log || { cat build/configure.log; exit 1; }
	@$(compile) engine_benchmarks
	@$(python) tests/benchmarks/run.py $(before)

# docs/performance.md from the last `make bench`.
bench-docs: build
	@$(python) tests/benchmarks/performance_page.py

# docs/robustness.md with its picture, from the characters of ../shared; takes about a minute.
robustness: build
	@$(python) tests/benchmarks/robustness_page.py

# docs/reliability.md: what happens at each fault of tests/faults.toml, by the tests that are marked with it, and what the
# last runs of faults, fuzz, sanitize, soak and coverage found; takes about 10 minutes. runs=1 adds those runs alone.
runs ?=
reliability: build
	@$(python) tests/benchmarks/reliability_page.py $(if $(runs),--longer-runs)

# docs/believable.md with its pictures, from every character of ../shared after one click, with two clips of each; takes
# about 15 minutes. only="Cow Fox" measures those again, at_once=1 one character at a time, which its seconds are best
# for. before=REVISION measures nothing and compares how alive they are with the page of that revision of git.
only ?=
before ?=
at_once ?= $(jobs)
believable: build
	@$(python) tests/benchmarks/believable.py --only "$(only)" $(if $(before),--before $(before),--jobs $(at_once))

# Its table of how the motion depends on the cage, and the page; takes about 4 minutes. sizes="2000 4000" skips the others.
sizes ?= 2000 4000 8000 16000
convergence: build
	@$(python) tests/benchmarks/convergence.py --sizes $(sizes)
	@$(python) tests/benchmarks/believable.py --page

# docs/accuracy.md with its plot, how far reduced motion is from unreduced over Detail; takes about 15 minutes.
# only="Cow Husky" measures those again, keep=1 only what was never measured.
keep ?=
accuracy: build
	@$(python) tests/benchmarks/accuracy.py --only "$(only)" $(if $(keep),--keep)

# docs/feels.md with its picture, the presets of Feel on six characters of ../shared; takes about 3 minutes.
feels: build
	@$(python) tests/benchmarks/feels.py

# docs/limit.md with its curves, what the limits of the motion do on six characters of ../shared; takes about 2 minutes.
limit: build
	@$(python) tests/benchmarks/limit.py

# docs/collision.md with its pictures: a ball pressed into characters of ../shared, beside Blender's own, and characters
# that fold up; takes about 15 minutes.
collision: build
	@$(python) tests/benchmarks/collision.py

# The table of docs/rigs.md: a human of each rig family, clicked and baked; takes about 2 minutes.
rigs: build
	@$(python) tests/benchmarks/rigs_page.py

# docs/how_long.md: seconds and memory of characters of 5,000 to 50,000 vertices; takes about 5 minutes.
how-long: build
	@$(python) tests/benchmarks/how_long.py

# The table of docs/comparison.md: a limb by Dynamorph and by Blender's own dynamics; takes about 2 minutes, and needs
# Python 3.13.
comparison: build
	@$(newest) tests/benchmarks/comparison.py

# docs/believable.md from what was measured before.
believable-docs: build
	@$(python) tests/benchmarks/believable.py --page

# docs/bakes.md with its pictures, from the characters of ../shared; takes a few minutes. sections="loops kills"
# measures those alone.
sections ?=
bakes: build
	@$(python) tests/benchmarks/bakes_page.py $(sections)

# Bakes on a Slurm of two nodes on this machine, and kills one of them; takes 5 to 10 minutes. What could not be installed
# (not root, not Debian) it names, and skips.
farm-demo: build
	@tools/setup.sh farm || :
	@$(python) tools/farm_demo.py

# Random input for all that reads a file, a command line or a mesh, for so many minutes in all: minutes=60. examples=2000
# tries so many spoiled meshes instead, which takes about 15 minutes. What fails is tried first next time.
examples ?=
minutes ?= 5
fuzz: build
	@$(if $(examples),DYNAMORPH_FUZZ=$(examples),DYNAMORPH_FUZZ_MINUTES=$(minutes)) $(python) -m pytest \
		--hypothesis-show-statistics tests/engine/test_defects.py \
		$(if $(examples),,tests/engine/test_fuzz.py tests/addon/cli/test_fuzz_commands.py)

# Random walks over all that an artist can press and change, in one process of Blender: no bug, nothing left, memory flat.
# minutes=60 walks so long, seed=7 that walk; steps=240 takes the first 240 steps of it again.
seed ?=
steps ?=
soak: build
	@$(python) tests/addon/soak.py $(if $(seed),--seed $(seed)) $(if $(steps),--steps $(steps),--minutes $(minutes))

# Every write, fsync, rename and open of each command fails once, and every allocation of the engine; `make test`
# tries a few: nothing is lost, nothing partial is left, and the message is right. Takes about 20 minutes.
faults: build
	@status=0; for each in $(shell ls -d .venv/3.*/bin/python); do \
	DYNAMORPH_FAULTS=all $$each -m pytest -rA tests/engine/test_allocations.py tests/addon/cli/test_failing_calls.py || status=$$?; \
	done; exit $$status

# docs/coverage.md: which lines and branches the tests run, C++ and Python, with what tests/not_covered.toml says of files
# that are low; takes up to an hour. tests="tests/engine tests/addon/cli/test_command_line.py" runs those alone, and writes to
# build/coverage.
tests ?=
coverage: build
	@tools/setup.sh coverage
	@.venv/coverage/bin/python tools/coverage_page.py $(python) $(tests)

# The engine's tests under gcc's sanitizers, with asserts, and random input for so many minutes: minutes=60. Takes about 30
# minutes besides, most of it the first build.
sanitize: setup
	@tools/sanitize.sh $(python) $(jobs) $(minutes)

# The stubs of the engine's Python module, for editors and type checkers, as it is compiled now.
stubs: build
	@$(stubgen) -o cpp/bindings

# Formats the sources, and fixes what the linter can.
format: setup
	@$(tools)ruff check --quiet --fix .
	@$(tools)ruff format --quiet .
	@$(tools)clang-format -i $(c_sources)

# Style, formatting, types, workflows, subjects of commits, and whether the stubs fit the compiled module.
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
	@$(stubgen) -o build/stubs
	@diff -u cpp/bindings/dynamorph/_core.pyi build/stubs/dynamorph/_core.pyi || { echo 'Run make stubs.'; exit 1; }

# Wheels of the engine for every system, and of the add-on, in dist/wheels; takes an hour the first time. platforms="linux-x64
# windows-x64" makes those alone; platforms=native packs what `make modules` compiles, for this machine alone, into dist/.
platforms ?=
wheels: $(before_wheels)
ifeq ($(platforms),native)
	@$(python) tools/package.py wheel
else
	@tools/setup.sh wheels
	@.venv/wheels/bin/python tools/wheels.py $(if $(platforms),--platforms $(platforms))
endif

# docs/platforms.md, from what `make wheels` made, with its C++ tests under Wine and QEMU; takes about an hour. speed=1
# measures the speed alone again.
speed ?=
platforms: build
	@tools/setup.sh platforms bench
ifeq ($(speed),)
	@.venv/wheels/bin/python tools/wheels.py
	@.venv/wheels/bin/python tools/wheels.py --tests --platforms linux-x64 linux-arm64 windows-x64
	@$(python) tools/package.py extension
endif
	@.venv/wheels/bin/python tests/benchmarks/platforms_page.py $(if $(speed),--speed-alone)

# The Blender extension as zips in dist/: one for each platform of the wheels in dist/wheels, and one for all of them.
# Without any such wheel it makes them first. platforms="linux-x64 windows-x64" packs those alone; platforms=native what
# `make modules` compiles, for this machine alone.
extension: $(before_packing)
	@$(python) tools/package.py extension $(platforms)

# A folder dist/repository with such zips, one for each platform, and the index that Blender's Get Extensions reads: any
# web server will do. platforms=native as above.
repository: $(before_packing)
	@$(python) tools/package.py repository $(platforms)

# The engine's sources in dist/, with TetGen's, for pip install on any system.
sdist: setup
	@mkdir -p build dist
	@$(python) -c 'from scikit_build_core.build import build_sdist; print("dist/" + build_sdist("dist"))' \
		>build/sdist.log 2>&1 || { cat build/sdist.log; exit 1; }
	@tail -n 1 build/sdist.log

# The engine as WebAssembly and the page around it, in build/playground (docs/playground.md); takes about 4 minutes the
# first time.
playground: module
	@tools/setup.sh site
	@$(python) tools/playground.py

# The website in build/site/html: docs/, references of the Python package and the C++ headers, and the playground.
# serve=1 also serves it to this machine.
serve ?=
site: playground
	@.venv/site/bin/python tools/site.py $(if $(serve),--serve)

# The version. new=0.2.0 opens that version in CHANGELOG.md, or dates it if it is open; then it is ready to be tagged.
new ?=
version:
	@python3 tools/version.py $(new)

# Removes what was built; .venv stays.
clean:
	@rm -rf build dist
