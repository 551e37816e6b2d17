"""Datasets on the disk: a Zarr store, pictures with masks, COCO; on demand YOLO and WebDataset."""

from __future__ import annotations

import json
import logging
import shutil
import signal
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from itertools import islice
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numba

from insonify.config.toml import config_to_toml
from insonify.errors import ConfigError, InsonifyError, MemoryLimitError, OutputError
from insonify.extras import optional
from insonify.imaging.collection import Collection
from insonify.imaging.dataset import Dataset
from insonify.io.folders import ResultFolder, result_folder, write_file
from insonify.mission.result import DatasetResult
from insonify.results.dataset import coco, shards, store, yolo
from insonify.results.dataset.card import Counts, write_card
from insonify.results.dataset.licences import licence_of
from insonify.results.files import CONFIG, save_result
from insonify.results.replay import PINGS, save_replay

DONE = "done"
"""Folder of one file for each view that is whole; gone when the dataset is."""
IMAGES, MASKS, STORE, ANNOTATIONS = "images", "masks", "dataset.zarr", "annotations.json"

_NO_ROOM = (MemoryLimitError, OutputError)
_log = logging.getLogger(__name__)
_views: Collection | None = None
"""What a worker process makes views of."""


def make_dataset(
    config: Dataset,
    target: Path,
    *,
    force: bool = False,
    workers: int = 1,
    mcap: bool = False,
    watch: Callable[[int], None] = lambda done: None,
    should_stop: Callable[[], bool] = lambda: False,
) -> tuple[DatasetResult | None, Path]:
    """Make a dataset in a folder, which appears when it is whole.

    What was made before a stop, a kill or a full disk is kept; the same call goes on from there.

    Args:
        config: What to make.
        target: The folder.
        force: Replace the results in it.
        workers: Processes; more than one want the caller guarded by ``__name__ == "__main__"``.
        mcap: Also write the views as a ROS 2 recording.
        watch: Called with the number of views that are whole, after each.
        should_stop: Asked after each view; if true the rest is left for another call.

    Returns:
        The figures, None if it was stopped; and the folder.

    Raises:
        OutputError: The folder exists, or cannot be written.
        InsonifyError: As `write_dataset`.
    """
    text = config_to_toml(config, "dataset") + _contents(config.materials)
    with result_folder(target, force=force, job=text, progress=_views_done) as place:
        if place.before is not None:
            place.before.replace(place.scratch)
        try:
            result = _written(config, place.scratch, workers, watch, should_stop)
        except BaseException as err:
            bad_input = isinstance(err, InsonifyError) and not isinstance(err, _NO_ROOM)
            if not bad_input:  # also if Ctrl-C came twice
                _keep(place, config.count)
            raise
        if result is None:
            _keep(place, config.count)
        else:
            (place.scratch / CONFIG).write_text(text, encoding="utf-8")
            if mcap:
                _write_replay(config, place.scratch)
            shutil.rmtree(place.scratch / DONE)  # last: killed before, nothing is made twice
    return result, place.target


def _write_replay(config: Dataset, folder: Path) -> None:
    """Write the views of a whole dataset as a ROS 2 recording."""
    heard = {"sonar": store.as_recording(folder / STORE)}
    frequency_hz = {"sonar": 1e3 * config.sonar.frequency_khz}
    save_replay(heard, folder / PINGS, frequency_hz, config.water.sound_speed_mps)


def _contents(materials: str) -> str:
    """The table of materials as comments, so that another one makes another dataset."""
    if not materials:
        return ""
    lines = Path(materials).read_text(encoding="utf-8").splitlines()
    return "".join(f"# {line}".rstrip() + "\n" for line in lines)


def _views_done(folder: Path) -> int:
    return sum(1 for _ in (folder / DONE).glob("*.json"))


def _keep(place: ResultFolder, count: int) -> None:
    """Leave what is whole for the same call to go on with."""
    place.kept, done = True, _views_done(place.scratch)
    _log.info("stopped after %d of %d views; the same command goes on from there", done, count)


def write_dataset(
    config: Dataset,
    folder: Path,
    *,
    workers: int = 1,
    watch: Callable[[int], None] = lambda done: None,
    should_stop: Callable[[], bool] = lambda: False,
) -> DatasetResult | None:
    """Write a dataset into a folder, or go on with what an earlier call left there.

    The files depend on the settings alone, not on the number of workers or on interruptions.

    Args:
        config: What to make.
        folder: Where; it exists, and holds nothing else.
        workers: As in `make_dataset`; so are ``watch`` and ``should_stop``.
        watch: Called with the number of views that are whole, after each.
        should_stop: Asked after each view; if true the folder is left for another call.

    Returns:
        In how many views each category is, and how many pixels show it; None if it was stopped.

    Raises:
        ConfigError: No pose was found for a view, there is no such world, or it has too many
            bodies.
        MemoryLimitError: A worker was killed.
        MissingExtraError: zarr is not installed, or what a format needs.
    """
    result = _written(config, folder, workers, watch, should_stop)
    if result is not None:
        shutil.rmtree(folder / DONE)
    return result


def _written(
    config: Dataset,
    folder: Path,
    workers: int,
    watch: Callable[[int], None],
    should_stop: Callable[[], bool],
) -> DatasetResult | None:
    """All of a dataset, and still the folder that says which of its views are whole."""
    views = _prepared(config, folder)
    missing = [k for k in range(config.count) if not _marker(folder, k).is_file()]
    done = config.count - len(missing)
    watch(done)
    for _ in _made(views, folder, views.by_world(missing), workers, should_stop):
        done += 1
        watch(done)
    if done < config.count:
        return None
    return _finished(views, folder)


def _finished(views: Collection, folder: Path) -> DatasetResult:
    """Write what is of all views, once they are whole."""
    config = views.config
    store.finish(folder / STORE, views, [row["pose"] for row in _rows(config, folder)])
    coco.write_annotations(folder / ANNOTATIONS, views, lambda: _rows(config, folder))
    if len(views.parts) > 1:
        for part in views.parts:
            path = folder / f"annotations-{part}.json"
            coco.write_annotations(path, views, lambda: _rows(config, folder), part)
    if "yolo" in config.formats:
        yolo.write_index(folder, views, IMAGES)
    if "webdataset" in config.formats:
        shutil.rmtree(folder / shards.SHARDS, ignore_errors=True)
        (folder / shards.SHARDS).mkdir()
        rows = _rows(config, folder)
        shards.write_shards(folder / shards.SHARDS, views, rows, folder / IMAGES, folder / MASKS)
    counts = Counts(views, _rows(config, folder))
    write_card(folder, counts, _files(views))
    result = DatasetResult(
        world=", ".join(config.worlds),
        sonar=config.sonar.name,
        seed=config.seed,
        views=config.count,
        categories=counts.categories,
        parts={
            part: {
                "views": int(total),
                "worlds": [name for name, its in zip(config.names, config.parts, strict=True)
                           if its == part],
            }
            for part, total in zip(views.parts, counts.total, strict=True)
        },
    )  # fmt: skip
    save_result(result, folder)
    return result


def _files(views: Collection) -> Iterator[tuple[str, str]]:
    """What lies in the folder of a dataset, for its card."""
    yield f"{IMAGES}/000000.png", "the image, 8 bits: a row a range bin, the nearest on top"
    yield f"{MASKS}/000000.png", "the category of each pixel, 0 for none"
    yield STORE, "all in full precision, with truth and poses (Zarr 3, for xarray)"
    yield ANNOTATIONS, "COCO"
    if len(views.parts) > 1:
        yield "annotations-PART.json", "COCO, of a part alone"
    if "yolo" in views.config.formats:
        yield f"{yolo.LABELS}/000000.txt", "YOLO: polygons"
        yield yolo.DATA, "YOLO: parts and categories"
    if "webdataset" in views.config.formats:
        yield f"{shards.SHARDS}/PART-000000.tar", "WebDataset: json, mask.png and png of each view"
    yield CONFIG, "the settings"


def _rows(config: Dataset, folder: Path) -> Iterator[dict[str, Any]]:
    """What was noted of each view, in order."""
    for number in range(config.count):
        yield json.loads(_marker(folder, number).read_text(encoding="utf-8"))


def _prepared(config: Dataset, folder: Path) -> Collection:
    """The views to be made, with folders and a store for them."""
    licence_of(config.license)
    if "yolo" in config.formats:
        optional("contourpy", "reports", "labels for YOLO")
    views = Collection(config)
    kinds = len(coco.categories_of(views.labels)) - 1
    if kinds > coco.MOST_LABELS:
        raise ConfigError(
            f"{', '.join(config.worlds)}: has {kinds} bodies, and a mask tells "
            f"{coco.MOST_LABELS} apart; merge some"
        )
    for name in (DONE, IMAGES, MASKS, *((yolo.LABELS,) if "yolo" in config.formats else ())):
        (folder / name).mkdir(exist_ok=True)
    if not (folder / STORE / "zarr.json").is_file() or not any((folder / DONE).iterdir()):
        shutil.rmtree(folder / STORE, ignore_errors=True)
        store.create(folder / STORE, views)
    store.tidy(folder / STORE)
    return views


def _made(
    views: Collection,
    folder: Path,
    missing: list[int],
    workers: int,
    should_stop: Callable[[], bool],
) -> Iterator[int]:
    """Make the missing views; yields each as soon as it is whole."""
    if workers == 1 or len(missing) < 2:
        for number in missing:
            _write_shot(views, folder, number)
            yield number
            if should_stop():
                return
        return
    ahead = iter(missing)
    with ProcessPoolExecutor(
        workers, get_context("spawn"), initializer=_begin, initargs=(views.config, views.labels)
    ) as pool:
        running: set[Future[int]] = set()
        while True:
            if not should_stop():
                fresh = islice(ahead, 2 * workers - len(running))
                running |= {pool.submit(_work, folder, number) for number in fresh}
            if not running:
                return
            finished, running = wait(running, return_when=FIRST_COMPLETED)
            for future in finished:
                try:
                    yield future.result()
                except BrokenProcessPool as err:
                    raise MemoryLimitError(
                        "a process that was making views was killed, most likely for want of "
                        "memory; start the same command again with fewer --workers"
                    ) from err


def _begin(config: Dataset, labels: tuple[str, ...]) -> None:
    """Prepare a worker process: its worlds, one thread, and no ears for Ctrl-C."""
    global _views
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    warnings.simplefilter("ignore")  # the first process has told them
    numba.set_num_threads(1)
    _views = Collection(config, labels)


def _work(folder: Path, number: int) -> int:
    assert _views is not None
    _write_shot(_views, folder, number)
    return number


def _write_shot(views: Collection, folder: Path, number: int) -> None:
    """Write all files of a view, and last the one that says that it is whole."""
    shot = views.shot(number)
    assert shot.truth is not None
    store.write(folder / STORE, shot)
    write_file(folder / IMAGES / coco.file_name(number), coco.image_png(shot.posed.ping))
    write_file(folder / MASKS / coco.file_name(number), coco.mask_png(shot.truth))
    if "yolo" in views.config.formats:
        labels = folder / yolo.LABELS / yolo.label_name(number)
        write_file(labels, yolo.label_text(shot.truth))
    write_file(_marker(folder, number), json.dumps(coco.row(shot)).encode())


def _marker(folder: Path, number: int) -> Path:
    return folder / DONE / f"{number:06d}.json"
