"""Simulating a sonar in a world."""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from insonify.cli.root import (
    EXIT_INTERRUPTED,
    ConfigOption,
    ForceOption,
    JsonOption,
    MaterialsOption,
    ModelOption,
    OutOption,
    RendererOption,
    SearchOption,
    SetOption,
    app,
    choices,
    interruptible,
    stderr,
    world_and_layers,
)
from insonify.errors import ConfigError

if TYPE_CHECKING:
    from insonify.scenarios import Table
    from insonify.simulation import Line, Record, Simulation, Turn, View


@app.command()
def simulate(
    world: Annotated[
        str | None,
        typer.Argument(
            help="SDF world or model, mesh file, scenario, or tank, grid, structures; or a named "
            "simulation: fls-tank, fls-grid, fls-structures, msis-tank, msis-turning, "
            "msis-structures."
        ),
    ] = None,
    sonar: Annotated[str | None, typer.Option(help="A device; see: sonars")] = None,
    pose: Annotated[
        str | None,
        typer.Option(metavar="'X Y Z ROLL PITCH YAW'", help="Ping here: metres, degrees."),
    ] = None,
    path: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Ping along these poses: CSV with x_m, ... or TUM."),
    ] = None,
    orbit: Annotated[
        str | None,
        typer.Option(
            metavar="'X Y Z RADIUS COUNT PITCH'", help="Ping around x, y at height z, looking in."
        ),
    ] = None,
    model: ModelOption = None,
    renderer: RendererOption = None,
    truth: Annotated[
        bool, typer.Option("--truth", help="Label, elevation, range, point, shadow of each pixel.")
    ] = False,
    camera: Annotated[
        bool, typer.Option("--camera", help="A camera's picture beside each ping (OpenGL).")
    ] = False,
    seed: Annotated[int | None, typer.Option(help="Seed of the noise.")] = None,
    search: SearchOption = None,
    materials: MaterialsOption = None,
    settings: SetOption = None,
    config: ConfigOption = None,
    out: OutOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Simulate a sonar in a world: images, arrays with their geometry, and their truth."""
    from insonify.io.folders import result_folder, unused_folder
    from insonify.scene.materials import read_materials
    from insonify.simulation import build_scene, simulation_config
    from insonify.simulation import simulate as run
    from insonify.sonar.camera import Camera

    device = {"preset": sonar} if sonar else None
    chosen = choices(sonar=device, model=model, renderer=renderer, seed=seed)
    chosen |= _route(pose, path, orbit)
    full = simulation_config(*world_and_layers(world, config, settings, chosen))
    scene = build_scene(full.world, search or (), read_materials(materials) if materials else None)
    eye = Camera(full.camera) if camera else None
    folder = out or unused_folder(
        Path("insonify-runs") / f"{Path(full.world).stem}-{full.sonar.name}"
    )
    with result_folder(folder, force=force) as place, interruptible() as interrupted:
        writer = _Writer(place.scratch, full, scene.labels)
        with _progress(full) as watch:
            for record in run(full, scene, with_truth=truth, camera=eye):
                watch(record)
                writer.write(record)
                if interrupted():
                    break
        result = writer.finish()
    if as_json:
        print(json.dumps(result, indent=2))
    else:
        _print_result(result)
    print(f"Results: {place.target}", file=sys.stderr)
    if interrupted():
        raise typer.Exit(EXIT_INTERRUPTED)


def _route(pose: str | None, path: Path | None, orbit: str | None) -> Table:
    """The one way in which the route is said, as a layer of settings."""
    if sum(way is not None for way in (pose, path, orbit)) > 1:
        raise ConfigError("give one of --pose, --path and --orbit, not several")
    if pose is not None:
        return {"route": [[0.0, *_numbers("--pose", pose, 6)]], "timed": True}
    if path is not None:
        from insonify.io.routes import read_route

        route = read_route(path)
        return {"route": [list(row) for row in route.rows], "timed": route.timed}
    if orbit is not None:
        from insonify.simulation import orbit as rows_around

        x, y, z, radius, count, pitch = _numbers("--orbit", orbit, 6)
        if count < 1 or count != int(count) or radius <= 0:
            raise ConfigError(f"--orbit needs a whole COUNT and a positive RADIUS, not {orbit!r}")
        rows = rows_around((x, y), z, radius, int(count), pitch)
        return {"route": [list(row) for row in rows], "timed": False}
    return {}


def _numbers(option: str, text: str, count: int) -> list[float]:
    try:
        values = [float(word) for word in text.replace(",", " ").split()]
    except ValueError as err:
        raise ConfigError(f"{option} takes {count} numbers, not {text!r}") from err
    if len(values) != count or not all(map(math.isfinite, values)):
        raise ConfigError(f"{option} takes {count} finite numbers, not {text!r}")
    return values


class _Writer:
    """Writes records as they come: arrays in ``pings``, pictures in ``pictures``."""

    def __init__(self, folder: Path, config: Simulation, labels: tuple[str, ...]) -> None:
        from insonify.io.configs import simulation_to_toml

        self.folder, self.config = folder, config
        self.arrays, self.pictures = folder / "pings", folder / "pictures"
        self.arrays.mkdir()
        self.pictures.mkdir()
        self.labels = labels
        self.rows: list[dict[str, Any]] = []
        self.lines: list[Line] = []
        self.points: list[Any] = []
        text = simulation_to_toml(config)
        (folder / "config.toml").write_text(text, encoding="utf-8")

    def write(self, record: Record) -> None:
        """Write a record."""
        from insonify.simulation import Line, Profile, Turn

        if isinstance(record, Line):
            self._write_line(record)
        elif isinstance(record, Turn):
            self._write_turn(record)
        elif isinstance(record, Profile):
            self.points.append(record.points)
            self._write_view(record.view)
        else:
            self._write_view(record)

    def finish(self) -> dict[str, Any]:
        """Write what is made of all records; the summary."""
        from insonify.io.pings import save_sidescan
        from insonify.report.fans import draw_soundings, draw_waterfall
        from insonify.simulation import waterfall

        if self.lines:
            image, bin_m = waterfall(self.lines), self.lines[0].port.geometry.bin_m
            save_sidescan(
                self.folder / "sidescan.npz", image, bin_m, [line.pose for line in self.lines]
            )
            self._picture("sidescan", draw_waterfall(image, bin_m, self._title()))
        if self.points:
            import numpy as np

            points = np.concatenate(self.points)
            np.savetxt(self.folder / "soundings.xyz", points, fmt="%.4f", header="x_m y_m z_m")
            self._picture("soundings", draw_soundings(points, self._title()))
        result = {
            "world": self.config.world,
            "sonar": self.config.sonar.name,
            "kind": self.config.sonar.kind.value,
            "model": self.config.model,
            "renderer": self.config.renderer,
            "seed": self.config.seed,
            "labels": list(self.labels),
            "pings": self.rows,
        }
        text = json.dumps(result, indent=2) + "\n"
        (self.folder / "result.json").write_text(text, encoding="utf-8")
        return result

    def _write_view(self, view: View) -> None:
        from insonify.io.pings import save_ping
        from insonify.report.fans import draw_fan, draw_polar, draw_truth, picture_png

        name, title = f"{view.number:04d}", self._title()
        save_ping(self.arrays / f"{name}.npz", view.ping, view.pose, view.truth)
        self._picture(f"{name}-fan", draw_fan(view.ping, title, 12.0))
        self._picture(f"{name}-polar", draw_polar(view.ping, title))
        if view.truth is not None:
            self._picture(f"{name}-truth", draw_truth(view.ping, view.truth, title, 12.0))
        if view.picture is not None:
            self._picture(f"{name}-camera", picture_png(view.picture))
        self._note(view.ping.time_s, view.pose, [view.truth] if view.truth else [])

    def _write_turn(self, turn: Turn) -> None:
        from insonify.io.pings import save_sweep
        from insonify.report.fans import draw_fan, draw_polar, picture_png

        name, title = f"{turn.number:04d}", self._title()
        save_sweep(self.arrays / f"{name}.npz", turn.pings, turn.polar, turn.deskewed, turn.truths)
        self._picture(f"{name}-fan", draw_fan(turn.polar, title, 8.0))
        self._picture(f"{name}-polar", draw_polar(turn.polar, title))
        self._picture(f"{name}-deskewed", draw_fan(turn.deskewed, f"{title}, de-skewed", 8.0))
        if turn.picture is not None:
            self._picture(f"{name}-camera", picture_png(turn.picture))
        for one in turn.pings:
            self._note(one.ping.time_s, one.pose, [], head_deg=math.degrees(one.head_rad))

    def _write_line(self, line: Line) -> None:
        from insonify.io.pings import save_ping

        self.lines.append(line)
        truths = line.truths or (None, None)
        sides = zip(("port", "starboard"), (line.port, line.starboard), truths, strict=True)
        for side, ping, truth in sides:
            save_ping(self.arrays / f"{line.number:04d}-{side}.npz", ping, line.pose, truth)
        self._note(line.port.time_s, line.pose, list(line.truths))

    def _title(self) -> str:
        config = self.config
        return f"{Path(config.world).stem}, {config.sonar.name}, {config.model}, {config.renderer}"

    def _picture(self, name: str, png: bytes) -> None:
        (self.pictures / f"{name}.png").write_bytes(png)

    def _note(self, time_s: float, pose: Any, truths: list[Any], **more: float) -> None:
        row: dict[str, Any] = {
            "time_s": round(time_s, 6),
            "position_m": list(pose.position_m),
            "rpy_deg": [math.degrees(a) for a in (pose.roll_rad, pose.pitch_rad, pose.yaw_rad)],
        } | more
        for truth in truths:
            for label, name in enumerate(truth.labels):
                count = int((truth.label == label).sum())
                row.setdefault("pixels", {}).setdefault(name, 0)
                row["pixels"][name] += count
            row["shadow_pixels"] = row.get("shadow_pixels", 0) + int(truth.shadow.sum())
        self.rows.append(row)


@contextmanager
def _progress(config: Simulation) -> Iterator[Callable[[Record], None]]:
    """A bar on stderr with the speed, beside the device's own."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from insonify.simulation import Turn, ping_times, turn_starts
    from insonify.sonar.devices import Kind

    console = stderr()
    scanning = config.sonar.kind is Kind.SCANNING
    total = len(turn_starts(config) if scanning else ping_times(config))
    own_hz = 1.0 / config.sonar.interval_s(config.water.sound_speed_mps)
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[speed]}"))
    with Progress(
        *columns, TimeElapsedColumn(), console=console, transient=True,
        disable=not console.is_terminal,
    ) as bar:  # fmt: skip
        task = bar.add_task(config.sonar.name, total=total, speed="")
        pings, started = 0, time.perf_counter()

        def watch(record: Record) -> None:
            nonlocal pings
            pings += len(record.pings) if isinstance(record, Turn) else 1
            rate = pings / (time.perf_counter() - started)
            bar.update(task, advance=1, speed=f"{rate:.1f} pings/s (device: {own_hz:.1f})")

        yield watch


def _print_result(result: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table as RichTable

    title = f"{result['world']}: {result['sonar']}, {result['model']}, {result['renderer']}"
    rows = result["pings"]
    with_truth = any("pixels" in row for row in rows)
    table = RichTable("time, s", "x, y, z, m", "roll, pitch, yaw, deg", title=title)
    if with_truth:
        table.add_column("pixels by label")
    for row in rows[:20]:
        cells = [
            f"{row['time_s']:.3f}",
            ", ".join(f"{value:.2f}" for value in row["position_m"]),
            ", ".join(f"{value:.1f}" for value in row["rpy_deg"]),
        ]
        if with_truth:
            counts = row["pixels"] | {"shadow": row["shadow_pixels"]}
            cells.append(", ".join(f"{name} {count}" for name, count in counts.items() if count))
        table.add_row(*cells)
    console = Console()
    console.print(table)
    if len(rows) > 20:
        console.print(f"... and {len(rows) - 20} more pings")
