#!/bin/bash
# SPDX-License-Identifier: GPL-3.0-or-later
# Installs missing system packages, and makes one virtual environment for each supported Python that it finds. It takes
# no time when there is nothing to do. What few people need is in groups, which are installed when they are named, as
# in `setup.sh emulate farm`:
#   bench     the benchmarks
#   coverage  what measures which lines the tests run (evidence/coverage_page.py)
#   emulate   the tests with another processor than this one (tests/engine/test_instruction_sets.py)
#   farm      the demo of a render farm; contains openjd
#   openjd    the tests of examples/farm/ with the tools of Open Job Description (tests/addon/package/test_farm.py)
#   platforms what runs the programs of other systems (evidence/platforms_page.py); contains emulate and wheels
#   site      what makes the website (tools/site.py)
#   wheels    the compiler for other systems, and what looks into its files (tools/wheels.py)
set -euo pipefail
cd "$(dirname "$0")/.."

packages=(g++ make python3-dev python3-venv libeigen3-dev libspectra-dev libcgal-dev nlohmann-json3-dev doctest-dev
          libsm6 libxi6 libxfixes3 libxrender1 libxkbcommon0 libgl1 libegl1 libgl1-mesa-dri) # second line: bpy
needs_coverage= needs_openjd= needs_site= needs_wheels=
for group in "$@"; do
  case $group in
    bench) packages+=(libbenchmark-dev) ;;
    coverage) needs_coverage=yes ;;
    emulate) packages+=(qemu-user) ;;
    farm) packages+=(slurmctld slurmd slurm-client munge) needs_openjd=yes ;;
    openjd) needs_openjd=yes ;;
    platforms) packages+=(qemu-user wine wine64) needs_wheels=yes ;;
    site) packages+=(doxygen emscripten nodejs) needs_site=yes ;;
    wheels) needs_wheels=yes ;;
    *) echo "setup: there is no group '$group': there are bench, coverage, emulate, farm, openjd, platforms, site and wheels" >&2
       exit 2 ;;
  esac
done
openjd=openjd-cli==0.8.0

install_packages() {
  if ! command -v dpkg-query >/dev/null; then
    echo "setup: not a Debian system. Needed here, as Debian names them: ${packages[*]}" >&2
    return
  fi
  local missing=() package
  for package in "${packages[@]}"; do
    [[ $(dpkg-query -W -f '${db:Status-Status}' "$package" 2>/dev/null) == installed ]] || missing+=("$package")
  done
  ((${#missing[@]})) || return 0
  if ((EUID != 0)); then
    echo "setup: missing packages. Install them, then run make again:" >&2
    echo "  sudo apt-get install ${missing[*]}" >&2
    exit 1
  fi
  echo "setup: installing ${missing[*]}"
  apt-get -qq update
  DEBIAN_FRONTEND=noninteractive apt-get -qq install -y --no-install-recommends "${missing[@]}" >/dev/null
}

find_python() { # version
  local candidate
  # The system's own first: it is what a newcomer has.
  for candidate in /usr/bin/"python$1" "python$1" "$HOME"/.pyenv/versions/"$1".*/bin/python; do
    # A shim may exist without the Python behind it, and a Python without its headers.
    if "$candidate" -c 'import sys, sysconfig, pathlib, ensurepip
assert "%d.%d" % sys.version_info[:2] == sys.argv[1]
assert pathlib.Path(sysconfig.get_path("include"), "Python.h").exists()' "$1" 2>/dev/null; then
      echo "$candidate"
      return
    fi
  done
}

make_environment() { # version, the Blender that has it
  local environment=.venv/$1 python
  if [[ ! -x $environment/bin/python ]]; then
    python=$(find_python "$1")
    if [[ -z $python ]]; then
      left_out+="setup: no Python $1 (with headers and venv), which $2 has: what needs it is left out"$'\n'
      return
    fi
    "$python" -m venv "$environment"
    made=yes
  fi
  if ! cmp -s tools/requirements.txt "$environment/requirements.txt"; then
    echo "setup: installing tools/requirements.txt for Python $1"
    "$environment/bin/python" -m pip install --quiet --disable-pip-version-check -r tools/requirements.txt
    cp tools/requirements.txt "$environment/requirements.txt"
  fi
  # The sources and the build directory are imported in place.
  printf '%s\n' "$PWD/build/cmake/python" "$PWD/addon" >"$("$environment/bin/python" -c \
    'import sysconfig; print(sysconfig.get_path("purelib"))')/dynamorph.pth"
}

make_openjd_environment() { # a separate one: it shares no package with Dynamorph
  local environment=build/openjd pythons=(.venv/3.*/bin/python)
  [[ $(cat $environment/requirements.txt 2>/dev/null) != "$openjd" ]] || return 0
  echo "setup: installing $openjd"
  "${pythons[0]}" -m venv $environment
  $environment/bin/python -m pip install --quiet --disable-pip-version-check $openjd
  echo $openjd >$environment/requirements.txt
}

make_tools_environment() { # name, of tools/NAME_requirements.txt
  local environment=.venv/$1 requirements=tools/$1_requirements.txt pythons=(.venv/3.*/bin/python)
  ! cmp -s "$requirements" "$environment/requirements.txt" || return 0
  echo "setup: installing $requirements"
  "${pythons[0]}" -m venv "$environment"
  "$environment/bin/python" -m pip install --quiet --disable-pip-version-check -r "$requirements"
  cp "$requirements" "$environment/requirements.txt"
}

install_packages
made= left_out=
make_environment 3.11 "Blender 4.5 LTS"
make_environment 3.13 "Blender 5.2 LTS"
if ! compgen -G '.venv/3.*/bin/python' >/dev/null; then
  echo "setup: Dynamorph needs Python 3.11 or 3.13, with headers and venv, on PATH or under ~/.pyenv" >&2
  exit 1
fi
[[ -z $made ]] || printf %s "$left_out" # once
[[ -z $needs_openjd ]] || make_openjd_environment
[[ -z $needs_coverage ]] || make_tools_environment coverage
[[ -z $needs_site ]] || make_tools_environment site
[[ -z $needs_wheels ]] || make_tools_environment wheels
