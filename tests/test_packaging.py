"""The built files carry what they should, and the installed wheel does its job."""

import inspect
import itertools
import os
import pkgutil
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import zipfile
from importlib.metadata import version
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name, parse_wheel_filename

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
STEM = f"{PROJECT['name']}-{PROJECT['version']}"
WHEEL = f"{STEM}-py3-none-any.whl"


def ran(*command: object, **options) -> str:
    """Output of a command that succeeds."""
    result = subprocess.run([*map(str, command)], capture_output=True, text=True, **options)
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """The folder of an sdist of the tree, and of a wheel made from that sdist alone."""
    folder = tmp_path_factory.mktemp("dist")
    ran(sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, ROOT)
    return folder


@pytest.fixture(scope="module")
def files(built) -> tuple[set[str], set[str]]:
    """Those of the wheel and of the sdist."""
    with zipfile.ZipFile(built / WHEEL) as wheel, tarfile.open(built / f"{STEM}.tar.gz") as sdist:
        names = {name.removeprefix(f"{STEM}/") for name in sdist.getnames()}
        return set(wheel.namelist()), names


@pytest.mark.nightly
def test_the_wheel_carries_every_file_of_the_package_the_license_and_nothing_beside(files):
    wheel_files, _ = files
    package = {
        path.relative_to(ROOT).as_posix()
        for path in ROOT.glob("vergence/**/*")
        if path.is_file() and not {"__pycache__", "shipped"} & set(path.parts)
    }
    assert {
        "vergence/models/presets/simulated.toml",
        "vergence/calibration/calibration.html.jinja",
        "vergence/reporting/report.html.jinja",
        "vergence/py.typed",
    } <= package
    licensed = f"{STEM}.dist-info/licenses/LICENSE"
    assert {*package, licensed} <= wheel_files
    assert {name.split("/")[0] for name in wheel_files} == {"vergence", f"{STEM}.dist-info"}


@pytest.mark.nightly
def test_built_files_carry_no_compiled_code(files):
    compiled = (".nbc", ".nbi", ".pyc", ".so")
    assert [name for name in set.union(*files) if name.endswith(compiled)] == []


@pytest.mark.nightly
def test_the_sdist_carries_the_model_folder_and_all_that_make_test_needs(files):
    _, sdist_files = files
    models = (ROOT / "models" / "bionic_eyes").rglob("*")
    tracked_models = {path.relative_to(ROOT).as_posix() for path in models if path.is_file()}
    assert tracked_models
    assert tracked_models <= sdist_files
    assert {
        "CHANGELOG.md", "LICENSE", "Makefile", "README.md", "constraints.txt", "docs", "benchmarks",
        "pyproject.toml", "tests/conftest.py", "vergence/models/presets/simulated.toml",
        "vergence/models/presets/physical.toml", "vergence/py.typed",
    } <= sdist_files | {name.split("/")[0] for name in sdist_files}  # fmt: skip


@pytest.mark.slow
def test_a_wheel_with_kernels_is_for_its_python_and_platform_and_one_without_for_all(tmp_path):
    for name in ("pyproject.toml", "hatch_build.py", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, tmp_path)
    shipped = tmp_path / "vergence" / "kernels" / "shipped"
    shipped.parent.mkdir(parents=True)
    build = (sys.executable, "-m", "build", "--no-isolation", "--wheel", tmp_path)
    ran(*build)
    assert [path.name for path in tmp_path.glob("dist/*")] == [WHEEL]
    shipped.mkdir()
    (shipped / "fit.nbc").touch()
    ran(*build)
    (made,) = {*tmp_path.glob("dist/*")} - {tmp_path / "dist" / WHEEL}
    *_, (tag,) = parse_wheel_filename(made.name)
    python = f"cp{sys.version_info.major}{sys.version_info.minor}"
    platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
    assert (tag.interpreter, tag.abi, tag.platform) == (python, python, platform)
    assert "vergence/kernels/shipped/fit.nbc" in zipfile.ZipFile(made).namelist()


def test_every_requirement_is_pinned_to_a_version_that_it_allows():
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    stated = (line.partition("==") for line in lines if not line.startswith("#"))
    pins = {canonicalize_name(name): version for name, _, version in stated}
    wanted = (PROJECT["dependencies"], *PROJECT["optional-dependencies"].values())
    for requirement in map(Requirement, itertools.chain(*wanted)):
        if requirement.name != PROJECT["name"]:
            pin = pins.get(canonicalize_name(requirement.name))
            assert pin is not None, f"{requirement} has no pin in constraints.txt"
            assert requirement.specifier.contains(pin), f"{requirement} excludes its pin {pin}"


INNER = {
    "base:BaseContext.insert_user_function": "self func fndesc libs",
    "caching:Cache._index_key": "self sig codegen",
    "caching:IndexDataCacheFile": "cache_path filename_base source_stamp",
    "codegen:JITCodeLibrary._finalize_dynamic_globals": "self",
    "codegen:JITCodeLibrary._finalize_final_module": "self",
    "codegen:JITCodeLibrary._optimize_final_module": "self",
    "codegen:JITCodeLibrary.serialize_using_object_code": "self",
    "compiler:CompileResult._rebuild": "target_context libdata fndesc env signature objectmode "
    "lifted typeann reload_init referenced_envs",
    "compiler:CompileResult._reduce": "self",
    "compiler:DefaultPassBuilder.define_nopython_pipeline": "state name",
    "registry:CPUDispatcher": "py_func locals targetoptions pipeline_class",
    "registry:CPUDispatcher._compile_for_args": "self args kws",
    "registry:CPUDispatcher.get_call_template": "self args kws",
    "typed_passes:NativeLowering.run_pass": "self state",
    "np.arrayobj:load_item": "context builder arrayty ptr",
    "np.arrayobj:populate_array": "array data shape strides itemsize meminfo parent",
    "np.ufunc.ufuncbuilder:GUFuncBuilder.build": "self cres",
    "np.ufunc.wrappers:_GufuncWrapper": "py_func cres sin sout cache is_parfors",
}
"""Inner functions of numba that `vergence.kernels` calls or replaces, with their parameters."""


def test_numba_is_a_release_that_the_kernels_are_tested_with():
    found = version("numba")
    todo = (
        f"numba {found} is not tested: run tests/test_kernels.py with it, then raise the bound in "
        "pyproject.toml; see vergence/kernels/__init__.py for how to take out each trick"
    )
    (numba,) = (r for r in map(Requirement, PROJECT["dependencies"]) if r.name == "numba")
    assert numba.specifier.contains(found), todo
    for name, parameters in INNER.items():
        place = f"numba.{name}" if name.startswith("np.") else f"numba.core.{name}"
        try:
            has = " ".join(inspect.signature(pkgutil.resolve_name(place)).parameters)
        except (ImportError, AttributeError) as error:
            has = str(error)
        assert has == parameters, f"{place} has changed. {todo}"


@pytest.mark.nightly
def test_the_installed_command_and_its_compiled_geometry_work(built, tmp_path):
    """The wheel comes before the environment of the tests, which has the dependencies."""
    folder = tmp_path / "installed"
    install = (sys.executable, "-m", "pip", "install", "--no-deps", "--no-index", "--target")
    ran(*install, folder, built / WHEEL)
    options = {"cwd": tmp_path, "env": os.environ | {"PYTHONPATH": str(folder)}}
    assert PROJECT["version"] in ran(folder / "bin" / "vergence", "info", **options)
    code = (
        "import vergence; print(vergence.__file__); head = vergence.load_head('simulated');"
        " print(*vergence.triangulate_gaze(head, head.fixate([0.0, -0.1, 1.0])).point)"
    )
    module, point = ran(sys.executable, "-c", code, **options).splitlines()
    assert Path(module).is_relative_to(folder)
    assert [float(word) for word in point.split()] == pytest.approx([0.0, -0.1, 1.0])


def test_the_base_install_has_no_part_that_only_some_need():
    """Parquet and a window weigh a tenth of an installation."""
    base = {canonicalize_name(Requirement(line).name) for line in PROJECT["dependencies"]}
    assert not base & {"pyarrow", "pygame", "torch"}
    assert "mujoco-core" not in base  # alone it breaks somebody's mujoco of another version
    extras = PROJECT["optional-dependencies"]
    assert {Requirement(line).name for line in extras["parquet"]} == {"pyarrow"}
    assert {Requirement(line).name for line in extras["render"]} == {"pygame"}
