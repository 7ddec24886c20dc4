"""Access to what MJX and its Warp engine keep private; nothing else in the package reads or writes it.

MJX promises nothing about these parts, so they may change with any minor version. Each function says which version
showed what it relies on, and `check_internals` refuses the versions that nobody has looked at.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, wraps
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

from maax_mjx.common.errors import MissingLibraryError
from maax_mjx.physics.warp_hessian import BLOCKS, LANES, SLOTS, repair_kernels
from maax_mjx.physics.warp_newton import Size, launch_newton

VERSIONS = {"mujoco-mjx": ("3.17", "3.18"), "warp-lang": ("1.18", "1.20")}
"""Versions by package: the first minor one that fits, and the first that does not. `pyproject.toml` says the same."""

PACKAGES = {"jax": ("mujoco-mjx",), "warp": ("mujoco-mjx", "warp-lang")}
"""Packages whose internals an engine relies on."""

LOST_CONTACTS = ("NEFC", "NJMAX_NNZ", "BROADPHASE", "NARROWPHASE", "CCD")
"""Names of Warp's overflows by which contacts are left out."""

ROW_STATES = ("SATISFIED", "QUADRATIC", "LINEARNEG", "LINEARPOS")
"""States of Warp's constraint rows, but for those of elliptic cones."""

EFC = ("J_rownnz", "J_rowadr", "J_colind", "J", "D", "aref", "frictionloss", "force", "state", "Ma")
"""Arrays of Warp's constraint rows that a solver reads and writes."""

READ = {
    "jax": (
        ("mujoco.mjx", "DataJAX", ("ne", "efc_J", "efc_D", "efc_aref", "contact")),
        ("mujoco.mjx", "Contact", ("dist", "dim")),
        ("mujoco.mjx._src.constraint", "make_efc_type", ()),
    ),
    "warp": (
        ("mujoco.mjx.warp.types", "DataWarp", ("naconmax", "naccdmax", "overflow", "contact__dist")),
        ("mujoco.mjx.warp.types", "OptionWarp", ("warn_overflow",)),
        ("mujoco.mjx.third_party.mujoco_warp", "OverflowType", (*LOST_CONTACTS, "ITERATIONS", "LS_ITERATIONS")),
        ("mujoco.mjx.third_party.mujoco_warp._src.types", "ConstraintState", ROW_STATES),
        ("mujoco.mjx.third_party.mujoco_warp._src.types", "IntegratorType", ("DISCRETE",)),
        ("mujoco.mjx.third_party.mujoco_warp._src.types", "ConeType", ("PYRAMIDAL",)),
        ("mujoco.mjx.third_party.mujoco_warp._src.types", "Constraint", EFC),
        ("mujoco.mjx.third_party.mujoco_warp._src.types", "Model", ("M_rownnz", "M_rowadr", "M_colind", "M_elemid")),
        ("mujoco.mjx.third_party.mujoco_warp._src.solver", "solve", ()),
        (
            "mujoco.mjx.third_party.mujoco_warp._src.types",
            "SolverContext",
            ("h", "quad_changed_ids", "quad_changed_count", "compact_m_full"),
        ),
        ("mujoco.mjx.third_party.mujoco_warp._src.solver", "_cholesky_factorize_solve", ()),
    ),
}
"""Modules, names in them, and attributes of these, that the functions below read for an engine."""

ROW_ORDER_XML = """
<mujoco>
  <worldbody>
    <body name="a">
      <joint name="j" type="slide" frictionloss="1" limited="true" range="0 1"/>
      <geom size="1" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <equality><joint joint1="j"/><connect body1="a" anchor="0 0 0"/></equality>
</mujoco>
"""
"""A model with four rows of equalities, and rows of other kinds."""


@cache
def check_internals(impl: str) -> None:
    """Checks, once per process, that the installed packages have the internals that an engine relies on.

    Takes some milliseconds: it compares versions, looks the names up, and has MJX lay out the constraint rows of a
    small model on the host. Nothing is compiled and no device is touched.

    Args:
        impl: "jax" or "warp".

    Raises:
        MissingLibraryError: they are missing or another version; the message says what is installed and what fits.
    """
    for package in PACKAGES[impl]:
        first, end = VERSIONS[package]
        if not _minor(first) <= _minor(_installed(package)) < _minor(end):
            raise _unknown_internals(package, _installed(package))
    lacking = [*_missing(impl)]
    if not lacking and impl == "jax" and not _equalities_come_first():
        lacking = ["equalities as the first constraint rows"]
    if lacking:
        raise _unknown_internals("mujoco-mjx", f"{_installed('mujoco-mjx')} without {', '.join(lacking)}")


def _unknown_internals(package: str, got: str) -> MissingLibraryError:
    first, end = VERSIONS[package]
    return MissingLibraryError(
        f"{package}: got {got}; takes {first} or later, below {end}: maax_mjx reads MJX's internals, which may differ "
        f"in others; pip install '{package}>={first},<{end}'"
    )


def _installed(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "none"


def _minor(number: str) -> tuple[int, ...]:
    """The first two parts of a version; none where it has none."""
    found = re.match(r"(\d+)\.(\d+)", number)
    return tuple(int(part) for part in found.groups()) if found else ()


def _missing(impl: str) -> Iterator[str]:
    """Names that an engine reads and that are not there."""
    for module, name, attributes in READ[impl]:
        try:
            owner = getattr(import_module(module), name)
        except (ImportError, AttributeError):
            yield f"{module}.{name}"
            continue
        known = {*dir(owner), *getattr(owner, "__dataclass_fields__", ())}
        yield from (f"{name}.{attribute}" for attribute in attributes if attribute not in known)


def _equalities_come_first() -> bool:
    """Whether MJX lays equalities out as the first constraint rows, and a connect as three of them."""
    from mujoco.mjx._src.constraint import make_efc_type

    is_equality = make_efc_type(mujoco.MjModel.from_xml_string(ROW_ORDER_XML)) == mujoco.mjtConstraint.mjCNSTR_EQUALITY
    return bool(is_equality[:4].all() and not is_equality[4:].any())


class ConstraintRows(NamedTuple):
    """The constraint rows of one world's data.

    Attributes:
        jacobian: (nefc, nv).
        weight: (nefc,) constraint masses, D in MuJoCo's documentation.
        reference: (nefc,) accelerations that the rows are drawn to.
        n_equalities: number of the first rows that pull as well as push.
    """

    jacobian: jax.Array
    weight: jax.Array
    reference: jax.Array
    n_equalities: int


def constraint_rows(d: mjx.Data) -> ConstraintRows:
    """Reads the constraint rows of MJX's JAX data, equalities first.

    Fields `efc_J`, `efc_D`, `efc_aref` and `ne`, and the order of `make_constraint`, seen in MJX 3.17.0.
    """
    return ConstraintRows(d._impl.efc_J, d._impl.efc_D, d._impl.efc_aref, d._impl.ne)


def add_to_connects(d: mjx.Data, connects: np.ndarray, accelerations: jax.Array) -> mjx.Data:
    """Adds to the reference accelerations of connects in MJX's JAX data.

    Field `efc_aref`, seen in MJX 3.17.0, where the first rows are those of the connects in the model's order, three of
    each whether it is active or not.

    Args:
        d: the data, its rows made.
        connects: (n,) indices among the model's connects.
        accelerations: (n, 3) along the axes of the world.
    """
    rows = 3 * connects[:, None] + np.arange(3)
    return d.tree_replace({"_impl.efc_aref": d._impl.efc_aref.at[rows].add(accelerations)})


def contact_distances(d: mjx.Data) -> jax.Array:
    """Reads the distances (n_contacts,) of the contact points that MJX's JAX data keeps, negative in contact.

    Field `contact`, seen in MJX 3.17.0, of as many points of each dimension as numeric `max_contact_points` at most,
    the deepest.
    """
    return d._impl.contact.dist


def contact_dimensions(d: mjx.Data) -> np.ndarray:
    """Reads the dimensions (n_contacts,) of these contact points, from data that are kept on the host."""
    return np.asarray(d._impl.contact.dim)


def without_overflow_warnings(m: mjx.Model) -> mjx.Model:
    """Keeps a model of Warp's from printing overflows from the device; `lost_contacts` reads them.

    Option `warn_overflow`, seen in MJX 3.17.0.
    """
    return m.tree_replace({"opt._impl.warn_overflow": 0})


def with_contact_room(d: mjx.Data, n_contacts: int, n_convex_pairs: int) -> mjx.Data:
    """Gives one world's Warp data the contact buffer that all worlds of its batch share.

    Fields `naconmax`, `naccdmax` and `contact__*`, seen in MJX 3.17.0; the arrays' first axis is that of contacts.

    Args:
        d: data of `mjx.make_data`, with room for at least one contact.
        n_contacts: contacts of all worlds that there is room for.
        n_convex_pairs: pairs of convex geoms that there is room for.
    """
    impl = d._impl
    contacts = {
        name: jnp.broadcast_to(getattr(impl, name)[:1], (n_contacts, *getattr(impl, name).shape[1:]))
        for name in impl.__dataclass_fields__
        if name.startswith("contact__") and np.size(getattr(impl, name))
    }
    return d.replace(_impl=impl.replace(naconmax=n_contacts, naccdmax=n_convex_pairs, **contacts))


def clear_overflow(d: mjx.Data) -> mjx.Data:
    """Resets the overflows that Warp's data counts; field `overflow`, seen in MJX 3.17.0."""
    return d.replace(_impl=d._impl.replace(overflow=jnp.zeros((), int)))


def lost_contacts(d: mjx.Data) -> jax.Array:
    """Tells whether Warp left contacts out for want of room since `clear_overflow`: () bool.

    Field `overflow`, bits of `OverflowType`, seen in MJX 3.17.0.
    """
    return (d._impl.overflow & _lost_contacts_bits()) != 0


@cache
def _lost_contacts_bits() -> int:
    # Warp takes seconds to import, and the jax engine does without.
    from mujoco.mjx.third_party.mujoco_warp import OverflowType

    return sum(int(OverflowType[name]) for name in LOST_CONTACTS)


@cache
def repair_hessians() -> None:
    """Has Warp's Newton solver repair its Hessian before it factorises it, in this process (see `warp_hessian`).

    `_cholesky_factorize_solve` is replaced by a function that looks first; seen in MJX 3.17.0, where rows are
    subtracted by `_update_gradient_incremental` alone, which then asks for worlds without changes to be skipped. The
    solver's context gets the room for what is found, since nothing can be allocated in a loop of a CUDA graph.
    """
    import warp
    from mujoco.mjx.third_party.mujoco_warp._src import solver, types

    create_context, factorise = solver._create_solver_context, solver._cholesky_factorize_solve
    active = int(types.ConstraintState.QUADRATIC)

    def created(m: Any, d: Any) -> Any:
        ctx = create_context(m, d)
        ctx.stiff, ctx.n_stiff = warp.empty(ctx.quad_changed_ids.size, dtype=warp.vec2i), warp.empty(1, dtype=int)
        return ctx

    def repaired(m: Any, d: Any, ctx: Any, skip_unchanged: bool = False, skip_noflip: bool = False) -> None:
        # Not with the discrete integrator, whose Hessian has more terms, nor where columns have other numbers since
        # degrees of freedom that are awake are packed, as MJX never does.
        discrete = m.opt.integrator == types.IntegratorType.DISCRETE
        if skip_unchanged and not discrete and ctx.compact_m_full is None:
            kernels = repair_kernels(bool(m.is_sparse), active)
            model = [m.nv, m.M_elemid, d.M]
            rows = [d.efc.J_rownnz, d.efc.J_rowadr, d.efc.J_colind, d.efc.J, d.efc.D, d.efc.state]
            changed, found = [ctx.quad_changed_ids, ctx.quad_changed_count], [ctx.stiff, ctx.n_stiff]
            ctx.n_stiff.zero_()
            warp.launch(kernels.find, dim=(d.nworld, SLOTS), inputs=[*model, *rows, *changed], outputs=found)
            inputs = [*model, d.nefc, *rows, *found]
            warp.launch_tiled(kernels.repair, dim=[BLOCKS], inputs=inputs, outputs=[ctx.h], block_dim=LANES)
        factorise(m, d, ctx, skip_unchanged=skip_unchanged, skip_noflip=skip_noflip)

    solver._create_solver_context = created
    solver._cholesky_factorize_solve = repaired


@cache
def solve_in_one_launch() -> None:
    """Has Warp's Newton solver do all iterations in one launch, in this process (see `warp_newton`).

    `solve` is replaced by a function that launches our kernels for worlds that they can solve; seen in MJX 3.17.0.
    Other models, solvers and cones go to MJX-Warp's, with its Hessians repaired.
    """
    import warp
    from mujoco.mjx.third_party.mujoco_warp._src import solver, types

    repair_hessians()
    solve, of_row, overflow = solver.solve, types.ConstraintState, types.OverflowType
    states = tuple((name, int(of_row[name])) for name in ROW_STATES)
    bits = (("NO_ITERATIONS_LEFT", int(overflow.ITERATIONS)), ("NO_LS_ITERATIONS_LEFT", int(overflow.LS_ITERATIONS)))

    @wraps(solve)
    def solved(m: Any, d: Any) -> None:
        size = Size(
            nv=m.nv,
            rows=d.njmax,
            sparse=bool(m.is_sparse),
            stride=d.efc.J.shape[-1],
            frictions=not m.opt.disableflags & types.DisableBit.FRICTIONLOSS,
            iterations=int(m.opt.iterations),
            ls_iterations=int(m.opt.ls_iterations),
            warmstart=not m.opt.disableflags & types.DisableBit.WARMSTART,
        )
        is_known = (
            m.opt.solver == types.SolverType.NEWTON
            and m.opt.cone == types.ConeType.PYRAMIDAL
            and m.opt.integrator != types.IntegratorType.DISCRETE
            and not m.opt.enableflags & types.EnableBit.SLEEP
        )
        device = warp.get_device()
        room = device.max_shared_memory_per_block if device.is_cuda else 2**20
        if not is_known or not size.fits(room):
            solve(m, d)
            return
        inertia = [m.M_rownnz, m.M_rowadr, m.M_colind, m.M_elemid]
        rows = [d.efc.J_rownnz, d.efc.J_rowadr, d.efc.J_colind, d.efc.J, d.efc.D, d.efc.aref, d.efc.frictionloss]
        inputs = [m.opt.tolerance, m.opt.ls_tolerance, d.ne, d.nf, d.nefc, *inertia, d.M, *rows]
        inputs += [d.qacc_warmstart, d.qacc_smooth, d.qfrc_smooth]
        outputs = [d.solver_niter, d.overflow, d.qacc, d.efc.Ma, d.qfrc_constraint, d.efc.force, d.efc.state]
        launch_newton(size, states + bits, inputs, outputs)
        if m.opt.noslip_iterations > 0:
            solver.noslip(m, d)

    solver.solve = solved


@contextmanager
def launched_one_by_one(around: Callable[[Callable[[Any, Any], None], Any, Any], None]) -> Iterator[None]:
    """Has programs that are traced inside launch Warp's kernels one by one, not as CUDA graphs, to time each.

    MJX makes its calls of Warp by `warp.jax_callable`, keeps them in a registry, and calls `mujoco_warp.step` in them;
    seen in MJX 3.17.0.

    Args:
        around: called in the place of a physics step, with the step and what it takes: Warp's model and data.
    """
    import warp
    from mujoco.mjx.third_party import mujoco_warp
    from mujoco.mjx.warp import ffi

    made, step, registry = warp.jax_callable, mujoco_warp.step, ffi._JAX_CALLABLE_VARIADIC_TUPLE_REGISTRY
    kept = dict(registry)

    def ungraphed(*args: Any, **kwargs: Any) -> Any:
        return made(*args, **{**kwargs, "graph_mode": warp.JaxCallableGraphMode.NONE})

    def watched(m: Any, d: Any) -> None:
        around(step, m, d)

    registry.clear()
    jax.clear_caches()
    warp.jax_callable, mujoco_warp.step = ungraphed, watched
    try:
        yield
    finally:
        warp.jax_callable, mujoco_warp.step = made, step
        registry.clear()
        registry.update(kept)
        jax.clear_caches()


def step_sizes(d: Any) -> dict[str, Any]:
    """Reads how much room Warp's data have, and how much of it a step used, as `benchmarks.launches.Sizes` names it.

    Fields `efc`, `nefc`, `nacon`, `naconmax`, `naccdmax`, `njmax` and `solver_niter`, seen in MJX 3.17.0.
    """
    rows, entries = d.nefc.numpy(), d.efc.J.shape[-1]
    used = float(entries)
    if len(d.efc.J_rownnz.shape) > 1 and d.efc.J_rownnz.shape[-1] >= d.njmax:
        lengths = d.efc.J_rownnz.numpy()[:, : d.njmax]
        used = float((lengths * (np.arange(lengths.shape[1]) < rows[:, None])).sum() / len(rows))
    return {
        "worlds": d.nworld,
        "contacts": d.naconmax,
        "pairs": d.naccdmax,
        "rows": d.efc.D.shape[-1],
        "entries": entries,
        "used_contacts": float(min(d.nacon.numpy()[0], d.naconmax)),
        "used_rows": float(rows.mean()),
        "used_entries": used,
        # On a CPU the former is a view of what the next step overwrites.
        "iterations": np.array(d.solver_niter.numpy()),
    }
