"""What the package knows of MJX's internals: where it does, that it is true here, and what it says where it is not."""

from __future__ import annotations

import ast
import re
import time
import tomllib
from dataclasses import make_dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import jax
import mujoco
import numpy as np
import pytest
from mujoco import mjx
from packaging.requirements import Requirement

import maax_mjx as maax
from maax_mjx.physics import mjx_internals

ROOT = Path(maax.__file__).parent
PRIVATE_MODULES = ("mujoco.mjx._src", "mujoco.mjx.third_party", "mujoco.mjx.warp")
PRIVATE_NAMES = re.compile(r"(.*\.)?_impl(\..*)?|efc_\w+|contact__\w*|naccdmax|warn_overflow|DataJAX|DataWarp")

XML = """
<mujoco>
  <worldbody>
    <body name="hinged">
      <joint name="hinge" axis="0 0 1" limited="true" range="-1 1"/><geom size=".1" pos="1 0 0"/>
    </body>
    <body name="first">
      <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint type="slide" axis="0 0 1"/>
      <geom size=".1" pos="0 5 0"/>
    </body>
    <body name="second">
      <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint type="slide" axis="0 0 1"/>
      <geom size=".1" pos="0 9 0"/>
    </body>
  </worldbody>
  <equality>
    <joint joint1="hinge"/>
    <weld body1="hinged"/>
    <connect body1="second" anchor="0 0 0"/>
    <connect body1="first" anchor="0 0 0" active="false"/>
  </equality>
</mujoco>
"""
HINGE, FIRST, SECOND = slice(0, 1), slice(1, 4), slice(4, 7)


@pytest.fixture
def fresh():
    """The check as in a process that has not made it yet."""
    mjx_internals.check_internals.cache_clear()
    return mjx_internals.check_internals


@pytest.mark.parametrize("impl", ["jax", "warp"])
def test_the_installed_packages_fit(impl, fresh):
    if impl == "warp":
        pytest.importorskip("warp")
    spent = []
    for _ in range(5):
        fresh.cache_clear()
        begun = time.perf_counter()
        fresh(impl)
        spent.append(time.perf_counter() - begun)
    assert min(spent) < 0.1


def test_it_is_made_once(fresh, monkeypatch):
    fresh("jax")
    monkeypatch.setattr(mjx_internals, "version", lambda name: "3.19.0")
    fresh("jax")


@pytest.mark.parametrize("number", ["3.16.4", "3.18.0", "3.19.0", "4.0.0rc1", "unknown"])
def test_another_mjx_is_refused(number, fresh, monkeypatch):
    monkeypatch.setattr(mjx_internals, "version", lambda name: number)
    sentence = (
        rf"mujoco-mjx: got {re.escape(number)}; takes 3\.17 or later, below 3\.18: maax_mjx reads MJX's internals, "
        r"which may differ in others; pip install 'mujoco-mjx>=3\.17,<3\.18'"
    )
    with pytest.raises(RuntimeError, match=sentence):
        fresh("jax")


def test_another_warp_is_refused_by_the_warp_engine_alone(fresh, monkeypatch):
    monkeypatch.setattr(mjx_internals, "version", lambda name: "1.20.0" if name == "warp-lang" else version(name))
    fresh("jax")
    with pytest.raises(RuntimeError, match=r"warp-lang: got 1\.20\.0; takes 1\.18 or later.*'warp-lang>=1\.18,<1\.20'"):
        fresh("warp")


def test_no_mjx_is_refused(fresh, monkeypatch):
    def nothing(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr(mjx_internals, "version", nothing)
    with pytest.raises(RuntimeError, match="mujoco-mjx: got none"):
        fresh("jax")


def test_a_missing_field_is_named(fresh, monkeypatch):
    names = set(mjx.DataJAX.__dataclass_fields__) - {"efc_aref"}
    monkeypatch.setattr(mjx, "DataJAX", make_dataclass("DataJAX", sorted(names)))
    with pytest.raises(RuntimeError, match=rf"mujoco-mjx: got {version('mujoco-mjx')} without DataJAX.efc_aref; takes"):
        fresh("jax")


def test_a_missing_class_is_named(fresh, monkeypatch):
    pytest.importorskip("warp")
    types = pytest.importorskip("mujoco.mjx.warp.types")
    monkeypatch.delattr(types, "OptionWarp")
    with pytest.raises(RuntimeError, match=r"without mujoco\.mjx\.warp\.types\.OptionWarp; takes"):
        fresh("warp")


def test_another_order_of_rows_is_refused(fresh, monkeypatch):
    from mujoco.mjx._src import constraint

    in_order = constraint.make_efc_type
    monkeypatch.setattr(constraint, "make_efc_type", lambda model: in_order(model)[::-1])
    with pytest.raises(RuntimeError, match="without equalities as the first constraint rows; takes"):
        fresh("jax")


@pytest.mark.parametrize("impl", ["jax", "warp"])
def test_engines_check(impl, fresh, monkeypatch):
    if impl == "warp":
        pytest.importorskip("warp")
    monkeypatch.setattr(mjx_internals, "version", lambda name: "3.19.0")
    with pytest.raises(RuntimeError, match=r"mujoco-mjx: got 3\.19\.0"):
        _ = maax.make("standard", impl=impl).engine


def test_connects_come_first_then_other_equalities():
    """By the degrees of freedom that rows depend on: a hinge's alone, and slides of one body and of another."""
    model = mujoco.MjModel.from_xml_string(XML)
    m = mjx.put_model(model, impl="jax")
    d = mjx.make_data(model, impl="jax").replace(eq_active=np.ones(4, bool), qpos=np.full(7, 2.0, np.float32))
    d = jax.jit(mjx.fwd_position)(m, d)
    rows = mjx_internals.constraint_rows(d)
    jacobian = np.asarray(rows.jacobian)
    assert rows.n_equalities == 3 + 3 + 6 + 1
    np.testing.assert_allclose(jacobian[:3, SECOND], np.eye(3), atol=1e-6)
    np.testing.assert_allclose(jacobian[3:6, FIRST], np.eye(3), atol=1e-6)
    assert not jacobian[:6, HINGE].any()
    assert np.count_nonzero(jacobian[6:12, HINGE]) > 0
    assert not jacobian[6:12, 1:].any()
    assert jacobian[12, 0] == 1, "the joint's equality"
    assert jacobian[13, 0] == -1, "the joint's limit, which pushes back from 2 to 1 radian"
    assert rows.weight.shape == rows.reference.shape == (len(jacobian),)

    added = mjx_internals.add_to_connects(d, np.array([1]), np.full((1, 3), 5, np.float32))
    difference = np.asarray(mjx_internals.constraint_rows(added).reference - rows.reference)
    np.testing.assert_allclose(difference, np.where((np.arange(len(jacobian)) // 3) == 1, 5, 0), atol=1e-3)


@pytest.mark.parametrize("name", sorted(mjx_internals.VERSIONS))
def test_pyproject_takes_the_same_versions(name):
    project = tomllib.loads((ROOT.parent / "pyproject.toml").read_text())["project"]
    texts = [*project["dependencies"], *(t for extra in project["optional-dependencies"].values() for t in extra)]
    bounds = [r.specifier for r in map(Requirement, texts) if r.name == name]
    first, end = mjx_internals.VERSIONS[name]
    assert bounds
    for bound in bounds:
        assert bound == Requirement(f"{name}>={first},<{end}").specifier


def internals(source):
    """Lines of a module that name what MJX and Warp keep private."""
    tree = ast.parse(source)
    texts = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        match node:
            case ast.Attribute(attr=name) | ast.keyword(arg=str(name)) | ast.Name(id=name):
                found = PRIVATE_NAMES.fullmatch(name) or name == "third_party"
            case ast.Constant(value=str(text)) if id(node) not in texts:
                found = PRIVATE_NAMES.fullmatch(text) or text.startswith(PRIVATE_MODULES)
            case ast.Import(names=aliases):
                found = any(alias.name.startswith(PRIVATE_MODULES) for alias in aliases)
            case ast.ImportFrom(module=str(module), names=aliases):
                found = any(f"{module}.{alias.name}".startswith(PRIVATE_MODULES) for alias in aliases)
            case _:
                found = False
        if found:
            yield node.lineno


@pytest.mark.parametrize(
    "line",
    [
        "d._impl.ne",
        "d.replace(_impl=x)",
        "d.tree_replace({'opt._impl.warn_overflow': 0})",
        "getattr(d, '_impl')",
        "rows = x.efc_J",
        "from mujoco.mjx.third_party.mujoco_warp import OverflowType",
        "from mujoco.mjx import third_party",
        "import mujoco.mjx._src.types",
        "mjx.third_party",
    ],
)
def test_the_walk_finds_uses(line):
    assert list(internals(f"'''of _impl'''\n{line}")) != []


def test_nothing_else_uses_internals():
    files = {path.relative_to(ROOT).as_posix(): [*internals(path.read_text())] for path in ROOT.rglob("*.py")}
    assert len(files) > 50
    # Of plain MuJoCo's data the rows are public.
    plain = {"core/diagnosis.py"}
    assert [name for name, lines in files.items() if lines and name not in plain] == ["physics/mjx_internals.py"]
