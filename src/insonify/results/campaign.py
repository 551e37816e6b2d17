"""What ``campaign`` leaves: a Parquet part for each run as soon as it is over, then tables of all.

A campaign that was killed goes on: runs whose part is there are not flown again.
"""

from __future__ import annotations

import fcntl
import io
import json
import logging
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from insonify.config.settings import Table
from insonify.config.toml import to_toml
from insonify.errors import MissingExtraError, OutputError, ResultError, reason
from insonify.extras import optional
from insonify.io.folders import RESULT, write_file
from insonify.mission.campaign import (
    FACTORS,
    CampaignSettings,
    chains,
    factors,
    read_campaign,
    run_key,
)
from insonify.mission.crew import Crew, Failure, Here, Landed, Processes, fly_all, known_runs
from insonify.mission.result import CampaignResult, ScanResult
from insonify.mission.setup import Config
from insonify.mission.tables import Campaign, curve_rows, run_row, summarise_campaign
from insonify.results.files import save_result

CAMPAIGN, REPORT = "campaign.toml", "report.html"
PARTS, FAILED, LOCK = "parts", "failed", ".lock"
TABLES = ("runs", "curves", "seconds")
"""Files ``NAME.parquet``, and what queries call them."""
_OURS = (PARTS, FAILED, LOCK)
"""There before the campaign's file, should the process be killed in between."""
_RESULT = b"insonify_result"
_HEAD = "A campaign; the same command goes on with it, or adds what is added here:"

_log = logging.getLogger(__name__)


def run_campaign(
    campaign: CampaignSettings,
    folder: Path,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    watch: Callable[[int, int, int], None] = lambda done, failed, planned: None,
    should_stop: Callable[[], bool] = lambda: False,
) -> CampaignResult:
    """Fly a campaign into a folder, or go on with the one that is there.

    Args:
        campaign: What to fly.
        folder: Made if it is not there.
        workers: Processes; more than one want the caller guarded by ``__name__ == "__main__"``.
        scheduler: Address of a Dask cluster that flies instead.
        watch: Called with the number of runs that are over, those that failed, and all.
        should_stop: Asked again and again; if true, runs that are not complete are broken off.

    Raises:
        OutputError: The folder holds something else, another process is at work in it, or it cannot
            be written.
        ClusterError: The cluster cannot be had; what is complete is kept.
        ConfigError: A name or a setting is not usable.
    """
    plan = chains(campaign)
    planned = sum(len(one.runs) for one in plan)
    _arrow()
    with _crew(workers, scheduler, should_stop) as crew, _opened(folder, campaign):
        done = failed = 0
        watch(done, failed, planned)
        for landed in fly_all(plan, crew, lambda run: _known(folder, run), should_stop):
            _save(folder, landed)
            failed += isinstance(landed.outcome, Failure)
            done += 1
            watch(done, failed, planned)
        _save_tables(folder, known_runs(plan, lambda run: _known(folder, run)))
        tables = load_campaign(folder)
        result = CampaignResult(
            title=campaign.title,
            runs=len(tables.runs),
            planned=planned,
            failed=failed,
            table=tuple(summarise_campaign(tables)) if len(tables.runs) else (),
        )
        save_result(result, folder)
        _report(tables, folder / REPORT)
    return result


def _crew(workers: int, scheduler: str | None, should_stop: Callable[[], bool]) -> Crew:
    if scheduler is not None:
        from insonify.mission.cluster import Cluster

        return Cluster(scheduler)
    return Here(should_stop=should_stop) if workers == 1 else Processes(workers)


@contextmanager
def _opened(folder: Path, campaign: CampaignSettings) -> Iterator[None]:
    """The folder of a campaign, for one process at a time; what was made of its parts goes."""
    if folder.exists() and not is_campaign(folder) and (
        not folder.is_dir() or any(file.name not in _OURS for file in folder.iterdir())
    ):  # fmt: skip
        raise OutputError(f"{folder}: already exists and is no campaign; give another --out")
    try:
        (folder / PARTS).mkdir(parents=True, exist_ok=True)
        (folder / FAILED).mkdir(exist_ok=True)
        lock = (folder / LOCK).open("w")
    except OSError as err:
        raise OutputError(
            f"{folder}: cannot be written ({reason(err)}); give another --out"
        ) from err
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as err:
            raise OutputError(
                f"{folder}: another process is at work on this campaign; wait for it, or end it"
            ) from err
        write_file(folder / CAMPAIGN, to_toml(campaign, f"{_HEAD}\ninsonify campaign DIR").encode())
        for name in (RESULT, REPORT, *(f"{table}.parquet" for table in TABLES)):
            (folder / name).unlink(missing_ok=True)
        for file in (folder / FAILED).glob("*.json"):  # they are tried again
            file.unlink()
        yield
        with suppress(OSError):
            (folder / FAILED).rmdir()  # if none failed
    (folder / LOCK).unlink(missing_ok=True)


def _save(folder: Path, landed: Landed) -> None:
    """Keep what came of a run, if it is new."""
    if landed.known:
        return
    key, outcome = run_key(landed.config), landed.outcome
    if isinstance(outcome, ScanResult):
        write_file(_part(folder, key), _part_bytes(key, landed.config, outcome))
        return
    told = {"run": key, **factors(landed.config), "message": outcome.message}
    text = json.dumps(told | {"traceback": outcome.traceback}, indent=2) + "\n"
    write_file(folder / FAILED / f"{key}.json", text.encode())


def _part(folder: Path, key: str) -> Path:
    return folder / PARTS / f"{key}.parquet"


def _part_bytes(key: str, config: Config, result: ScanResult) -> bytes:
    """A run's moments, and in the file's metadata its result."""
    table = _table(curve_rows(key, config, result))
    return _parquet(table.replace_schema_metadata({_RESULT: result.model_dump_json().encode()}))


def _known(folder: Path, config: Config) -> ScanResult | None:
    """The result in a run's part, if it is there."""
    file = _part(folder, run_key(config))
    if not file.is_file():
        return None
    try:
        metadata = optional("pyarrow.parquet", "campaigns", "a campaign").read_schema(file).metadata
        return ScanResult.model_validate_json(metadata[_RESULT])
    except (OSError, ValueError, KeyError, TypeError) as err:
        raise ResultError(
            f"{file}: cannot be read as a run's part ({reason(err)}); delete it, and the same "
            "command flies the run again"
        ) from err


def _save_tables(folder: Path, found: Iterable[Landed]) -> None:
    """Write the tables of the runs that are complete: the same bytes however they came about."""
    for name, table in _tables(folder, found).items():
        write_file(folder / f"{name}.parquet", _parquet(table))


def _tables(folder: Path, found: Iterable[Landed]) -> dict[str, Any]:
    """Arrow tables by name."""
    arrow = _arrow()
    parts, runs, seconds = [], [], []
    for landed in found:
        assert isinstance(landed.outcome, ScanResult)
        key = run_key(landed.config)
        parts.append(_read(_part(folder, key)).replace_schema_metadata(None))
        runs.append(run_row(key, landed.config, landed.outcome))
        seconds.append({"run": key} | landed.outcome.seconds)
    curves = arrow.concat_tables(parts, promote_options="permissive") if parts else _table([])
    return {"runs": _table(runs), "curves": curves.combine_chunks(), "seconds": _table(seconds)}


def is_campaign(folder: Path) -> bool:
    """Whether a folder is one of `run_campaign`."""
    return (folder / CAMPAIGN).is_file()


def load_campaign(folder: Path | str) -> Campaign:
    """The results of a campaign, also of one that is still flown.

    Raises:
        ResultError: It is no campaign's folder, or a file in it is damaged.
        MissingExtraError: pandas or pyarrow is not installed.
    """
    folder = Path(folder)
    optional("pandas", "campaigns", "a campaign's tables")
    settings, tables = _loaded(folder)
    try:
        records = [
            json.loads(file.read_text(encoding="utf-8"))
            for file in (folder / FAILED).glob("*.json")
        ]
    except (OSError, ValueError) as err:
        raise ResultError(f"{folder / FAILED}: cannot be read ({reason(err)})") from err
    frames = {name: table.to_pandas() for name, table in tables.items()}
    records.sort(key=lambda row: [str(row[name]) for name in FACTORS])
    return Campaign(settings.title, **frames, failed=tuple(records))


def _loaded(folder: Path) -> tuple[CampaignSettings, dict[str, Any]]:
    """A campaign's settings and its Arrow tables: the files, or what its parts make."""
    if not is_campaign(folder):
        raise ResultError(f"{folder}: is no folder of a campaign; check the path")
    settings = read_campaign(folder / CAMPAIGN)
    files = {name: folder / f"{name}.parquet" for name in TABLES}
    if all(file.is_file() for file in files.values()):
        return settings, {name: _read(file) for name, file in files.items()}
    found = known_runs(chains(settings), lambda run: _known(folder, run))
    return settings, _tables(folder, found)


def query(folder: Path | str, sql: str) -> tuple[list[str], list[tuple[Any, ...]]]:
    """Ask a campaign's tables `TABLES` in SQL.

    Args:
        folder: Of the campaign.
        sql: As DuckDB understands it.

    Returns:
        Names of columns, and rows.

    Raises:
        ResultError: It is no campaign, or no SQL that fits its tables.
    """
    duckdb = optional("duckdb", "campaigns", "--sql")
    _, tables = _loaded(Path(folder))
    with duckdb.connect() as connection:
        for name, table in tables.items():
            connection.register(name, table)
        try:
            answer = connection.execute(sql)
            return [column[0] for column in answer.description or ()], answer.fetchall()
        except duckdb.Error as err:
            raise ResultError(
                f"--sql: {reason(err)}; the tables are {', '.join(TABLES)}, and `describe runs` "
                "lists columns"
            ) from err


def _report(tables: Campaign, path: Path) -> None:
    """The report; without the packages for it a campaign is whole too, and its log says so."""
    try:
        from insonify.report.campaign_html import write_campaign_report
    except MissingExtraError as err:
        _log.warning("no report is written: %s", err)
    else:
        write_campaign_report(tables, path)


def _arrow() -> Any:
    return optional("pyarrow", "campaigns", "a campaign")


def _table(rows: list[Table]) -> Any:
    """Rows as an Arrow table; a column that holds nothing is one of numbers."""
    arrow = _arrow()
    names = list(dict.fromkeys(name for row in rows for name in row)) or ["run"]
    columns = {name: arrow.array([row.get(name) for row in rows]) for name in names}
    empty = {name: column for name, column in columns.items() if arrow.types.is_null(column.type)}
    return arrow.table(columns | {name: col.cast(arrow.float64()) for name, col in empty.items()})


def _parquet(table: Any) -> bytes:
    buffer = io.BytesIO()
    parquet = optional("pyarrow.parquet", "campaigns", "a campaign")
    parquet.write_table(table, buffer, compression="zstd")
    return buffer.getvalue()


def _read(file: Path) -> Any:
    try:
        return optional("pyarrow.parquet", "campaigns", "a campaign").read_table(file)
    except (OSError, ValueError) as err:
        raise ResultError(f"{file}: cannot be read as Parquet ({reason(err)})") from err
