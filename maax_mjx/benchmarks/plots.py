"""Pictures of results, drawn from their JSON files.

A kind of picture is one function of an empty figure and a record's rows; `FIGURES` says which files it draws.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from maax_mjx.benchmarks import plots_cost, plots_learning, plots_scaling, plots_worlds, record
from maax_mjx.benchmarks.axes import Fill
from maax_mjx.benchmarks.bench import Command, Options
from maax_mjx.training.folder import CURVES, METRICS, Folder

FIGURES: dict[str, Fill] = {
    **plots_worlds.FIGURES,
    **plots_cost.FIGURES,
    **plots_scaling.FIGURES,
    **plots_learning.FIGURES,
}
"""Kinds of pictures by the beginning of a file's name, up to the first underscore."""


@dataclass
class Config:
    """Options.

    Attributes:
        folder: its JSON files are drawn, each into a PNG beside it; files without a kind of picture are passed over.
            So are the metrics of the runs in `runs/`. The default is docs/results of a checkout.
    """

    folder: Path = record.RESULTS


def draw(path: Path, fill: Fill) -> Path:
    """Draws a record into a PNG of the same name beside it.

    Args:
        path: a JSON file that `record.write` wrote.
        fill: what to draw of its rows.

    Returns:
        The picture's path.

    Raises:
        ValueError: the file is not a record, or has no rows.
    """
    found = record.read(path)
    rows = found["rows"]
    if not rows:
        raise ValueError(f"path: got {path}, which has no rows; takes a record of at least one")
    figure = Figure(layout="constrained")
    FigureCanvasAgg(figure)
    fill(figure, rows)
    trained_on = [row["devices"] for row in rows if isinstance(row.get("devices"), list)]
    line = caption(found["conditions"], sorted({name for names in trained_on for name in names}))
    figure.supxlabel(line, fontsize=8, color="#555555")
    picture = path.with_suffix(".png")
    figure.savefig(picture, dpi=130)
    return picture


def caption(conditions: dict[str, Any], trained_on: Sequence[str] = ()) -> str:
    """Line that says where and when a record was measured.

    Args:
        conditions: of the record.
        trained_on: devices of the runs that a record of training was read from, perhaps on another machine.
    """
    if trained_on:
        return f"trained on {', '.join(trained_on)}; {conditions['date']}"
    devices = conditions["devices"]
    count = f"{len(devices)} x " if len(devices) > 1 else ""
    versions = ", ".join(f"{name} {conditions['packages'][name]}" for name in ("jax", "mujoco"))
    return f"{count}{devices[0]}, {conditions['cpus']} CPU cores; {versions}; {conditions['date']}"


def with_picture(command: Command[Any], fill: Fill) -> Command[Any]:
    """The same program, which draws its file at the end.

    Args:
        command: a program with `Options`.
        fill: what to draw of its rows.
    """

    def main(options: Options) -> None:
        command.main(options)
        if options.out is not None and options.out.exists():
            draw(options.out, fill)

    return Command(command.config, main)


def main(config: Config) -> None:
    """Draws every picture and prints its path.

    Raises:
        ValueError: the folder does not exist, or a file is not a record.
    """
    if not config.folder.is_dir():
        raise ValueError(f"folder: got {config.folder}; takes a folder of JSON records")
    for path in sorted(config.folder.glob("*.json")):
        fill = FIGURES.get(path.stem.split("_")[0])
        if fill is not None:
            print(draw(path, fill))
    for path in sorted(config.folder.glob(f"runs/*/{METRICS}")):
        Folder(path.parent).draw(finished=True)
        print(path.with_name(CURVES))


COMMAND = Command(Config, main)

if __name__ == "__main__":
    COMMAND.cli()
