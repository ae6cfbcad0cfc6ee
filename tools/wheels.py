# SPDX-License-Identifier: GPL-3.0-or-later
"""Wheels of the engine for every system, compiled on one Linux machine: `make wheels`, into dist/wheels.

The compiler is zig: Clang with the C libraries of all systems. Python's headers come from Debian, for each Python from
the release that has it. A wheel carries nothing but the engine; `check` looks into each for what else it would load.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path

from package import version

ROOT = Path(__file__).resolve().parent.parent
WORK = ROOT / "build/wheels"
DIST = ROOT / "dist/wheels"
TOOLS = Path(sys.executable).parent  # of the environment of tools/wheels_requirements.txt
MIRROR = "http://deb.debian.org/debian"
KEYS = Path("/usr/share/keyrings/debian-archive-keyring.gpg")


@dataclass(frozen=True)
class Platform:
    """What a wheel is compiled for."""

    target: str  # zig's
    system: str  # CMake's
    processor: str  # CMake's
    tag: str  # of the wheel
    suffix: str  # of the modules' names, with {} for 311
    debian: str  # the processor whose pyconfig.h fits

    def modules(self, python: str) -> list[str]:
        """The file names of a wheel's modules."""
        return [name + self.suffix.format(python.replace(".", "")) for name in ("_core", "_mesher")]


# By Blender's names. macOS has Linux's sizes of all types, and its headers ask pyconfig.h for little else.
PLATFORMS = {
    "linux-x64": Platform("x86_64-linux-gnu.2.28", "Linux", "x86_64", "manylinux_2_28_x86_64",
                          ".cpython-{}-x86_64-linux-gnu.so", "amd64"),
    "linux-arm64": Platform("aarch64-linux-gnu.2.28", "Linux", "aarch64", "manylinux_2_28_aarch64",
                            ".cpython-{}-aarch64-linux-gnu.so", "arm64"),
    "windows-x64": Platform("x86_64-windows-gnu", "Windows", "AMD64", "win_amd64",
                            ".cp{}-win_amd64.pyd", "windows"),
    "windows-arm64": Platform("aarch64-windows-gnu", "Windows", "ARM64", "win_arm64",
                              ".cp{}-win_arm64.pyd", "windows"),
    "macos-arm64": Platform("aarch64-macos.11.0", "Darwin", "arm64", "macosx_11_0_arm64",
                            ".cpython-{}-darwin.so", "arm64"),
    "macos-x64": Platform("x86_64-macos.11.0", "Darwin", "x86_64", "macosx_11_0_x86_64",
                          ".cpython-{}-darwin.so", "amd64"),
}  # fmt: skip
SUITES = {"3.11": "bookworm", "3.13": "trixie", "3.14": "sid"}  # the Debian release that has each Python
# Blender 5.2, with Python 3.13, is not made for Intel's Macs; Python 3.14 is that of Debian's own Blender.
LEFT_OUT = {("macos-x64", "3.13")} | {(name, "3.14") for name in PLATFORMS if not name.startswith("linux")}
HEADERS = {  # libraries of headers alone, and where Debian has them
    "Eigen": "/usr/include/eigen3/Eigen", "unsupported": "/usr/include/eigen3/unsupported",
    **{name: f"/usr/include/{name}" for name in ("Spectra", "CGAL", "boost", "nlohmann", "doctest")},
}  # fmt: skip


def pythons_of(name: str) -> list[str]:
    """The Pythons that a platform has wheels for."""
    return [python for python in SUITES if (name, python) not in LEFT_OUT]


def wheel_path(name: str, python: str) -> Path:
    number = python.replace(".", "")
    return DIST / f"dynamorph-{version()}-cp{number}-cp{number}-{PLATFORMS[name].tag}.whl"


def run(*command: str | Path, **options) -> str:
    """A command's output; ends the program with what it printed if it fails."""
    words = [str(word) for word in command]
    done = subprocess.run(
        words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, encoding="utf-8", check=False, **options
    )
    if done.returncode:
        sys.exit(f"{done.stdout[-8000:]}\nwheels: failed: {' '.join(words)}")
    return done.stdout


# Headers -------------------------------------------------------------------------------------------------------------


def library_headers() -> Path:
    """A folder with the libraries' headers alone: /usr/include itself would bring this machine's C library in."""
    folder = WORK / "include"
    folder.mkdir(parents=True, exist_ok=True)
    for name, path in HEADERS.items():
        link = folder / name
        if not link.is_symlink():
            link.symlink_to(path)
        if not link.exists():
            sys.exit(f"wheels: {path} is missing: tools/setup.sh installs it on Debian")
    # Boost reads this header of glibc 2.32, without asking whether it is there: 0 is "there may be other threads".
    (folder / "glibc/sys").mkdir(parents=True, exist_ok=True)
    (folder / "glibc/sys/single_threaded.h").write_text("static const char __libc_single_threaded = 0;\n")
    return folder


def python_headers(python: str) -> Path:
    """Folders amd64, arm64 and windows with Python.h and its kin, fetched once."""
    folder = WORK / "python" / python
    if folder.exists():
        return folder
    print(f"wheels: fetching the headers of Python {python} from Debian {SUITES[python]}", flush=True)
    new = folder.with_name(f"{python}.new")
    shutil.rmtree(new, ignore_errors=True)
    for processor in ("amd64", "arm64"):
        package = apt(new / "apt", SUITES[python], processor, "download", f"libpython{python}-dev").glob("*.deb")
        unpacked = new / "unpacked" / processor
        unpacked.mkdir(parents=True)
        run("dpkg-deb", "-x", next(package), unpacked)
        shutil.copytree(unpacked / f"usr/include/python{python}", new / processor)
        # Debian's own pyconfig.h only chooses among those of its processors.
        shutil.copy2(next(unpacked.glob(f"usr/include/*/python{python}/pyconfig.h")), new / processor)
    if python in pythons_of("windows-x64"):
        sources = apt(new / "apt", SUITES[python], "amd64", "source", "--download-only", f"python{python}")
        shutil.copytree(new / "amd64", new / "windows")
        with tarfile.open(next(sources.glob("*.orig.tar.?z"))) as archive:
            member = next(each for each in archive.getmembers() if re.search(r"/PC/pyconfig\.h(\.in)?$", each.name))
            (new / "windows/pyconfig.h").write_bytes(archive.extractfile(member).read())
    shutil.rmtree(new / "apt")
    shutil.rmtree(new / "unpacked")
    new.rename(folder)
    return folder


def apt(root: Path, suite: str, processor: str, *command: str) -> Path:
    """Runs apt-get for another release and processor than this machine's; it checks Debian's signatures.

    Returns the folder in which it leaves files.
    """
    if not shutil.which("apt-get") or not KEYS.exists():
        sys.exit(
            "wheels: Python's headers are fetched from Debian's archive by apt-get, which this system does not have"
        )
    root = root / f"{suite}-{processor}"
    files = root / "files"
    for part in ("lists/partial", "cache/archives/partial", "etc/apt.conf.d", "etc/preferences.d", "files"):
        (root / part).mkdir(parents=True, exist_ok=True)
    (root / "status").touch()
    source = f"[signed-by={KEYS}] {MIRROR} {suite} main\n"
    (root / "etc/sources.list").write_text(f"deb {source}deb-src {source}")
    settings = root / "apt.conf"
    # A mirror may be behind: then its lists are past their date.
    settings.write_text(
        f'Dir "{root}/"; Dir::State "{root}"; Dir::State::status "{root}/status"; Dir::Cache "{root}/cache";\n'
        f'Dir::Etc "{root}/etc"; APT::Architecture "{processor}"; APT::Architectures {{ "{processor}"; }};\n'
        'Acquire::Check-Valid-Until "false"; APT::Sandbox::User "root";\n'
    )
    environment = os.environ | {"APT_CONFIG": str(settings)}
    run("apt-get", "-qq", "update", env=environment)
    run("apt-get", "-qq", *command, cwd=files, env=environment)
    return files


def exported_names(headers: Path) -> list[str]:
    """What Python's library exports, as its headers declare it, in the words of a .def file."""
    names = set()
    for header in headers.rglob("*.h"):
        text = header.read_text(encoding="utf-8")
        # Not the stand-ins for threads that Python has for a system without them.
        declared = re.findall(r"\bPyAPI_(FUNC|DATA)\([^;]*?\)\s*(_?P[yY]\w+)\s*[(;\[]", text)
        names |= {name + (" DATA" if kind == "DATA" else "") for kind, name in declared}
    return sorted(names)


def import_library(python: str, headers: Path, platform: Platform, folder: Path) -> None:
    """What a Windows module is linked to instead of python311.dll itself."""
    library = f"python{python.replace('.', '')}"
    definitions = folder / f"{library}.def"
    definitions.write_text("\n".join([f"LIBRARY {library}.dll", "EXPORTS", *exported_names(headers), ""]))
    machine = "arm64" if platform.processor == "ARM64" else "i386:x86-64"
    zig("dlltool", "-m", machine, "-d", definitions, "-l", folder / f"{library}.lib")


# Compiling -----------------------------------------------------------------------------------------------------------


def zig_environment() -> dict[str, str]:
    return os.environ | {name: str(WORK / "zig") for name in ("ZIG_GLOBAL_CACHE_DIR", "ZIG_LOCAL_CACHE_DIR")}


def zig(*command: str | Path) -> str:
    return run(sys.executable, "-m", "ziglang", *command, env=zig_environment())


def compile_modules(name: str, pythons: list[str], tests: bool) -> Path:
    """CMake's build folder for a platform, with its modules and, if asked for, the C++ tests."""
    platform, folder = PLATFORMS[name], WORK / name
    folder.mkdir(parents=True, exist_ok=True)
    # CMake takes the path of a compiler, not a command.
    for tool, words in {"c++": f"c++ -target {platform.target}", "ar": "ar", "ranlib": "ranlib"}.items():
        script = folder / f"zig-{tool}"
        script.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m ziglang {words} "$@"\n')
        script.chmod(0o755)
    modules = []
    for python in pythons:
        headers = python_headers(python)
        if platform.system == "Windows":
            import_library(python, headers / platform.debian, platform, folder)
        suffix = platform.suffix.format(python.replace(".", ""))
        modules.append(f"{python}|{headers / platform.debian}|{suffix}")
    include = library_headers()
    # No path of this machine in the files, and no undefined behavior checks, which are zig's default.
    flags = f"-isystem {include} -fno-sanitize=undefined -ffile-prefix-map={ROOT}=. -ffile-prefix-map={WORK}=build"
    if platform.system == "Linux":
        flags += f" -I {include}/glibc"  # before zig's own
    if platform.system == "Windows":
        flags += " -D_USE_MATH_DEFINES"
    definitions = {
        "CMAKE_BUILD_TYPE": "Release",
        "CMAKE_SYSTEM_NAME": platform.system, "CMAKE_SYSTEM_PROCESSOR": platform.processor,
        "CMAKE_CXX_COMPILER": folder / "zig-c++", "CMAKE_AR": folder / "zig-ar", "CMAKE_RANLIB": folder / "zig-ranlib",
        "CMAKE_CXX_FLAGS": flags, "CMAKE_MAKE_PROGRAM": TOOLS / "ninja", "CMAKE_OSX_SYSROOT": "",
        "CMAKE_OSX_DEPLOYMENT_TARGET": "", "CMAKE_INSTALL_NAME_TOOL": "true",
        "CMAKE_MODULE_LINKER_FLAGS": "-s", "CMAKE_SHARED_LINKER_FLAGS": "-s",
        "EIGEN_INCLUDE": include, "SPECTRA_INCLUDE": include, "JSON_INCLUDE": include, "CGAL_INCLUDE": include,
        "DOCTEST_INCLUDE": include, "DYNAMORPH_PYTHONS": sys.executable, "DYNAMORPH_WERROR": "OFF",
        "DYNAMORPH_CROSS_PYTHONS": ";".join(modules), "DYNAMORPH_TESTS": "ON" if tests else "OFF",
    }  # fmt: skip
    options = [f"-D{key}={value}" for key, value in definitions.items()]
    environment = zig_environment()
    run(TOOLS / "cmake", "-S", ROOT, "-B", folder, "-G", "Ninja", "--log-level=WARNING", *options, env=environment)
    run(TOOLS / "cmake", "--build", folder, "--", "--quiet", env=environment)
    return folder


# Packing -------------------------------------------------------------------------------------------------------------


def template() -> Path:
    """The wheel without its modules, unpacked: what does not depend on the system."""
    folder = WORK / "template"
    shutil.rmtree(folder, ignore_errors=True)
    pip = (sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation")
    run(*pip, "--config-settings=wheel.cmake=false", "-w", folder, ROOT)
    run(TOOLS / "wheel", "unpack", "-d", folder, next(folder.glob("*.whl")))
    return folder / f"dynamorph-{version()}"


def pack(source: Path, build: Path, name: str, python: str) -> Path:
    """The wheel of a platform and a Python, with its list of components."""
    import sbom  # needs packages that tests of this module do without

    stage = WORK / "stage" / source.name
    shutil.rmtree(stage, ignore_errors=True)
    shutil.copytree(source, stage)
    for module in PLATFORMS[name].modules(python):
        shutil.copy2(build / "python/dynamorph" / module, stage / "dynamorph")
    information = stage / f"dynamorph-{version()}.dist-info"
    tag = wheel_path(name, python).stem.removeprefix(f"dynamorph-{version()}-")
    wheel = (information / "WHEEL").read_text(encoding="utf-8")
    wheel = re.sub(r"^Root-Is-Purelib: .*$", "Root-Is-Purelib: false", wheel, flags=re.MULTILINE)
    (information / "WHEEL").write_text(re.sub(r"^Tag: .*$", f"Tag: {tag}", wheel, flags=re.MULTILINE), encoding="utf-8")
    (information / "sboms").mkdir()
    (information / "sboms/dynamorph.cdx.json").write_text(sbom.document(version(), name), encoding="utf-8")
    for path in stage.rglob("*"):
        path.chmod(0o755 if path.is_dir() else 0o644)  # whatever this user's umask
    DIST.mkdir(parents=True, exist_ok=True)
    run(TOOLS / "wheel", "pack", "-d", DIST, stage, env=os.environ | {"SOURCE_DATE_EPOCH": source_date()})
    return wheel_path(name, python)


def source_date() -> str:
    """The time of the files in a wheel: that of the last commit, or the earliest that a zip can say."""
    shown = subprocess.run(["git", "log", "-1", "--format=%ct"], cwd=ROOT, capture_output=True, text=True, check=False)
    return os.environ.get("SOURCE_DATE_EPOCH") or shown.stdout.strip() or "315532800"


def add_on() -> Path:
    """The add-on as a wheel of its own, for `python -m dynamic_morph_targets`."""
    pip = (sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation")
    run(*pip, "-w", DIST, ROOT / "addon", env=os.environ | {"SOURCE_DATE_EPOCH": source_date()})
    wheel = DIST / f"dynamic_morph_targets-{version()}-py3-none-any.whl"
    wheel.chmod(0o644)  # flit makes a file that only its owner can read
    return wheel


# Checks --------------------------------------------------------------------------------------------------------------

# Libraries that every system has, or that Python brings.
SYSTEM_LIBRARIES = {
    "Linux": r"lib(c|m|dl|pthread|rt)\.so\.\d+|ld-linux-(x86-64|aarch64)\.so\.\d",
    "Windows": r"(?i)(kernel32|ntdll|ucrtbase|bcrypt|python3\d+|api-ms-win-crt-[\w-]+)\.dll",
    "Darwin": r"/usr/lib/libSystem\.B\.dylib|@rpath/_(core|mesher)\..*",  # the latter is its own name
}


def check(wheel: Path, name: str, python: str) -> str:
    """What a wheel's modules are and load, in one line. Ends the program if they would load what not everybody has."""
    platform = PLATFORMS[name]
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        loaded = {each for module in platform.modules(python) for each in check_module(archive, module, name)}
    if platform.system == "Linux":
        shown = run(TOOLS / "auditwheel", "show", wheel, env=os.environ | {"PATH": f"{TOOLS}:{os.environ['PATH']}"})
        policy = platform.tag.removesuffix(f"_{platform.processor}")
        floor = re.search(r'"(manylinux_2_(\d+))_\w+"', shown.replace("\n", " "))
        if not floor or int(floor[2]) > 28:
            sys.exit(f"{shown}\nwheels: {wheel.name} is not {policy}")
    if platform.system == "Windows":
        run(TOOLS / "delvewheel", "show", "--ignore-existing", wheel)
    with tempfile.TemporaryDirectory() as folder:  # it would put libraries into the wheel that others do not have
        run(TOOLS / "repairwheel", "--no-sys-paths", "-o", folder, wheel)
        with zipfile.ZipFile(next(Path(folder).glob("*.whl"))) as archive:
            if added := {each for each in archive.namelist() if not each.endswith("/")} - names:
                sys.exit(f"wheels: {wheel.name} is not whole: repairwheel adds {sorted(added)}")
    return ", ".join(sorted(loaded))


def check_module(archive: zipfile.ZipFile, module: str, platform: str) -> list[str]:
    """The libraries that a module of a wheel loads, after the checks of that module alone."""
    import lief

    lief.logging.disable()  # it complains of details that no loader reads
    data, where = archive.read(f"dynamorph/{module}"), f"{module} for {platform}"
    binary = lief.parse(data)
    libraries = [str(getattr(each, "name", each)) for each in binary.libraries]
    foreign = [each for each in libraries if not re.fullmatch(SYSTEM_LIBRARIES[PLATFORMS[platform].system], each)]
    exported = {each.name.lstrip("_") for each in binary.exported_functions if "PyInit" in each.name}
    if foreign or exported != {f"PyInit_{module.partition('.')[0]}"}:
        sys.exit(f"wheels: {where} loads {foreign} and exports {sorted(exported)}")
    if platform == "macos-arm64" and not binary.has_code_signature:
        sys.exit(f"wheels: {where} has no signature, without which macOS does not load it")
    if str(ROOT).encode() in data:
        sys.exit(f"wheels: {where} names folders of this machine")
    return libraries


# ---------------------------------------------------------------------------------------------------------------------


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--platforms", nargs="*", default=[], choices=PLATFORMS, metavar="NAME", help=", ".join(PLATFORMS)
    )
    parser.add_argument("--pythons", nargs="*", default=[], choices=SUITES, metavar="VERSION", help=", ".join(SUITES))
    parser.add_argument(
        "--tests", action="store_true", help="compile the C++ tests, too: build/wheels/NAME/engine_tests"
    )
    args = parser.parse_args()
    WORK.mkdir(parents=True, exist_ok=True)
    source = template()
    print("| platform | Python | MB | SHA-256 | loads |\n|---|---|---:|---|---|")
    for name in args.platforms or PLATFORMS:
        pythons = [each for each in pythons_of(name) if not args.pythons or each in args.pythons]
        if not pythons:
            continue
        build = compile_modules(name, pythons, args.tests)
        for python in pythons:
            wheel = pack(source, build, name, python)
            content = wheel.read_bytes()
            digest = hashlib.sha256(content).hexdigest()[:16]
            loads = check(wheel, name, python)
            print(f"| {name} | {python} | {len(content) / 1e6:.2f} | {digest} | {loads} |", flush=True)
    print(add_on().relative_to(ROOT))


if __name__ == "__main__":
    main()
