"""Free memory is the least of what the machine, a container and ulimit leave."""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from insonify import memory

GIB = 1 << 30


def test_it_is_never_more_than_the_machine_has() -> None:
    assert 0 < memory.free_bytes() <= psutil.virtual_memory().available * 1.05
    assert memory.fits(1) and not memory.fits(1 << 60)


def _group(folder: Path, **files: str) -> None:
    folder.mkdir(parents=True)
    for name, text in files.items():
        (folder / name.replace("__", ".")).write_text(text)


def test_a_control_group_of_version_2_counts_and_so_do_those_above_it(tmp_path: Path) -> None:
    root, own = tmp_path / "cgroup", tmp_path / "self"
    own.write_text("0::/slice/box\n")
    stat = f"anon 5\ninactive_file {GIB // 4}\n"
    _group(
        root / "slice/box", memory__max=f"{2 * GIB}\n", memory__current=f"{GIB}\n",
        memory__stat=stat,
    )  # fmt: skip
    (root / "slice/memory.max").write_text("max\n")
    (root / "slice/memory.current").write_text("7\n")
    (root / "slice/memory.stat").write_text(stat)
    assert list(memory._cgroup_bytes(root, own)) == [GIB + GIB // 4]
    (root / "slice/memory.max").write_text(f"{GIB}\n")
    assert list(memory._cgroup_bytes(root, own)) == [GIB + GIB // 4, GIB - 7 + GIB // 4]


def test_a_control_group_of_version_1(tmp_path: Path) -> None:
    root, own = tmp_path / "cgroup", tmp_path / "self"
    own.write_text("5:cpu:/\n9:memory:/box\n")
    _group(
        root / "memory/box", memory__limit_in_bytes=f"{GIB}", memory__usage_in_bytes=f"{GIB // 2}",
        memory__stat=f"total_inactive_file {GIB // 8}\n",
    )  # fmt: skip
    (root / "memory/memory.limit_in_bytes").write_text("9223372036854771712")
    (root / "memory/memory.usage_in_bytes").write_text("5")
    (root / "memory/memory.stat").write_text("total_inactive_file 0\n")
    assert list(memory._cgroup_bytes(root, own)) == [GIB // 2 + GIB // 8]


def test_no_control_groups_leave_no_limit(tmp_path: Path) -> None:
    assert list(memory._cgroup_bytes(tmp_path, tmp_path / "none")) == []


@pytest.mark.skipif(sys.platform != "linux", reason="ulimit -v is Linux's")
def test_ulimit_counts() -> None:
    code = (
        "import resource; from insonify import memory\n"
        f"resource.setrlimit(resource.RLIMIT_AS, ({4 * GIB}, {4 * GIB}))\n"
        "print(memory.free_bytes())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 0 < int(done.stdout) < 4 * GIB
    assert resource.getrlimit(resource.RLIMIT_AS)[0] != 4 * GIB
