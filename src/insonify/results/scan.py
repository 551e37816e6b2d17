"""What ``scan`` leaves: figures, map, decisions, truth, track, report (recording: `recorder`)."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from itertools import accumulate
from pathlib import Path

from insonify.config.layers import read_table
from insonify.config.toml import config_to_toml
from insonify.errors import InsonifyError, MissingExtraError, ResultError
from insonify.io.decisions import load_decisions, save_decisions
from insonify.io.folders import RESULT, ResultFolder, result_folder, unused_folder
from insonify.io.maps import load_map, save_map, save_point_cloud
from insonify.io.recordings import open_recording
from insonify.io.trajectories import load_track, save_track
from insonify.io.truth import load_truth, save_truth
from insonify.mission.account import Account
from insonify.mission.loop import Step
from insonify.mission.result import ScanResult
from insonify.mission.run import KEYFRAMES, Remembered, Run, execute
from insonify.mission.setup import Config
from insonify.planning.decision import DecisionRecord, Planner
from insonify.results.files import CONFIG, RECORDING, load_result, save_result
from insonify.results.mappers import save_mapper
from insonify.types import Box, PosedPing, ScanPath, StopReason

MAP, CLOUD, DECISIONS, TRUTH = "map.npz", "map.ply", "decisions.npz", "truth.npz"
TRACK, REPORT = "trajectory.csv", "report.html"

_log = logging.getLogger(__name__)


def run_scan(
    config: Config,
    target: Path,
    *,
    force: bool = False,
    watch: Callable[[Run, Step], None] = lambda run, step: None,
    phase: Callable[[str], None] = lambda name: None,
    should_stop: Callable[[], bool] = lambda: False,
    pace: Callable[[float], None] = lambda time_s: None,
) -> tuple[ScanResult, Path]:
    """Run a scan and leave all of it in a folder, which appears when it is whole.

    A scan of the same config to the same folder that was interrupted, or whose process was killed,
    is gone on with.

    Args:
        config: What to run.
        target: The folder.
        force: Replace the results in it.
        watch: Called after every step.
        phase: Called with the name of what is done after the last step.
        should_stop: Asked after every ping; if true the run ends there, scored as it stands.
        pace: Called with a vehicle's time as it goes on; it may wait.

    Returns:
        The figures, and the folder, which has another name if ``target`` was taken meanwhile.

    Raises:
        OutputError: The folder exists, or cannot be written.
        InsonifyError: The config does not make a world that can be scanned.
    """
    text = config_to_toml(config, "scan")
    cut_short = is_interrupted(target, text)
    force |= cut_short
    with result_folder(target, force=force, job=text, progress=_recorded_bytes) as place:
        past = _going_on_after(place.before or (target if cut_short else None))
        fly = partial(execute, config, remembered=past, should_stop=should_stop, pace=pace)
        with _kept_if_stopped(place):
            run = _recorded(place, watch, fly)
        result = _save_or_keep(run, place, phase)
    return result, place.target


def _going_on_after(before: Path | None) -> Iterator[Remembered]:
    """The pings of a scan that was broken off, which is said."""
    from insonify.results.resume import remembered

    known, past = (0, iter(())) if before is None else remembered(before)
    if known:
        _log.info("going on after the %d pings of a scan that was broken off", known)
    return past


def place_for(config: Config, wanted: Path) -> Path:
    """Where a scan goes that was given no folder: one of the same that was interrupted, or a new.

    Args:
        config: What is to be run.
        wanted: The folder, or ``wanted-2``, ``wanted-3`` ... where there are others.
    """
    text = config_to_toml(config, "scan")
    return unused_folder(wanted, or_one=lambda folder: is_interrupted(folder, text))


def is_interrupted(folder: Path, config_toml: str) -> bool:
    """Whether a folder holds a scan of a config that was interrupted, to go on with."""
    try:
        same = (folder / CONFIG).read_text(encoding="utf-8") == config_toml
        result = load_result(folder) if same and (folder / RECORDING).is_file() else None
    except (OSError, UnicodeDecodeError, ResultError):
        return False
    return isinstance(result, ScanResult) and result.stop_reason is StopReason.INTERRUPTED


@contextmanager
def _kept_if_stopped(place: ResultFolder) -> Iterator[None]:
    """What is recorded is kept to go on with if the user stops the block at once."""
    try:
        yield
    except Exception:
        raise
    except BaseException:
        place.kept = True
        raise


def run_scan_by(
    planner: Planner,
    config: Config,
    target: Path,
    *,
    force: bool,
    watch: Callable[[Run, Step], None],
    should_stop: Callable[[], bool],
    pace: Callable[[float], None],
) -> tuple[ScanResult, Path]:
    """`run_scan` with a planner that decides instead of the config's, and is not asked twice.

    What a kill breaks off is not gone on with.
    """
    with result_folder(target, force=force) as place:
        fly = partial(execute, config, planner, should_stop=should_stop, pace=pace)
        result = save_scan(_recorded(place, watch, fly), place.scratch)
    return result, place.target


def _recorded(
    place: ResultFolder, watch: Callable[[Run, Step], None], fly: Callable[..., Run]
) -> Run:
    """A run whose steps are recorded, and watched."""
    from insonify.results.recorder import recording

    with recording(place.scratch) as record:

        def each(run: Run, step: Step) -> None:
            watch(run, step)
            record(run, step)

        return fly(watch=each)


def _recorded_bytes(folder: Path) -> int:
    return (folder / RECORDING).stat().st_size


def _save_or_keep(run: Run, place: ResultFolder, phase: Callable[[str], None]) -> ScanResult:
    """Save a run; what was scanned is kept if a fault in a user's mapper is in the way."""
    try:
        with _kept_if_stopped(place):
            return save_scan(run, place.scratch, phase)
    except (OSError, InsonifyError):
        raise
    except Exception:
        _log.warning("the scan could not be saved; the same command goes on after its pings")
        place.kept = True
        raise


def save_scan(
    run: Run, folder: Path | str, phase: Callable[[str], None] = lambda name: None
) -> ScanResult:
    """Write a run into a folder that exists: all but its recording, which is written as it goes.

    `run_scan` does both.
    """
    folder = Path(folder)
    phase("writing the map")
    account = run.account()
    if run.flight is not None:
        save_track(run.flight.track, folder / TRACK)
    save_result(account.result, folder)
    (folder / CONFIG).write_text(account.config_toml, encoding="utf-8")
    save_map(account.voxels, folder / MAP)
    save_mapper(run.mapper, folder)
    threshold = run.config.entropy.high_entropy
    save_point_cloud(account.voxels, folder / CLOUD, threshold, account.region)
    save_decisions(folder / DECISIONS, account.decisions, account.paths)
    save_truth(folder / TRUTH, account.truth, run.world.scene)
    phase("writing the report")
    _report(account, folder / REPORT)
    return account.result


def _report(account: Account, path: Path) -> None:
    """The report; without the packages for it a scan is whole too, and its log says what lacks."""
    try:
        from insonify.report.html import write_report
    except MissingExtraError as err:
        _log.warning("no report is written: %s", err)
    else:
        write_report(account, path)


def is_scan(folder: Path) -> bool:
    """Whether a folder is one of `save_scan`, with all that `load_run` needs."""
    names = (RESULT, CONFIG, DECISIONS, TRUTH, MAP)
    return all((folder / name).is_file() for name in names)


def load_run(folder: Path | str, *, with_keyframes: bool = False) -> Account:
    """Read a run back: nothing is run again, and neither its planner nor its mesh is needed.

    Args:
        folder: Of the result.
        with_keyframes: Read pings for pictures from its recording too, which takes a while.

    Raises:
        ResultError: It is no such folder, or of a version without decisions.
        InsonifyError: One of its files is missing or damaged.
    """
    folder = Path(folder)
    folder = folder.parent if folder.name == RESULT else folder
    result = load_result(folder)
    if not isinstance(result, ScanResult):
        raise ResultError(f"{folder}: the result of another command ({result.kind}), not of scan")
    if not (folder / DECISIONS).is_file() or result.region_m is None:
        raise ResultError(
            f"{folder}: has no {DECISIONS}, as runs of older versions of insonify; "
            f"scan again (insonify scan --config {folder / CONFIG})"
        )
    read_table(folder / CONFIG)
    truth, solids = load_truth(folder / TRUTH)
    decisions, paths = load_decisions(folder / DECISIONS)
    return Account(
        result=result,
        config_toml=(folder / CONFIG).read_text(encoding="utf-8"),
        region=Box.of(*result.region_m),
        voxels=load_map(folder / MAP),
        truth=truth,
        solids=solids,
        decisions=decisions,
        paths=paths,
        keyframes=_keyframes(folder, decisions, paths) if with_keyframes else (),
        moments=() if result.vehicle is None else load_track(folder / TRACK),
    )


def _keyframes(
    folder: Path, decisions: tuple[DecisionRecord, ...], paths: tuple[ScanPath, ...]
) -> tuple[tuple[int, PosedPing], ...]:
    """The pings of a recording that a run keeps for pictures; none if it was not recorded."""
    if not (folder / RECORDING).is_file():
        return ()
    planned = [made.decision.path for made in decisions if made.decision.path is not None]
    starts = accumulate((len(path.waypoints) for path in paths), initial=0)
    wanted = {
        start + quarter * len(path.waypoints) // 4: scan
        for scan, (start, path, flown) in enumerate(zip(starts, planned, paths, strict=False), 1)
        for quarter in KEYFRAMES
        if quarter * len(path.waypoints) // 4 < len(flown.waypoints)
    }
    return tuple(
        (wanted[number], posed)
        for number, posed in enumerate(open_recording(folder / RECORDING))
        if number in wanted
    )
