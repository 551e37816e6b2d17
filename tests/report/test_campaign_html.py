from __future__ import annotations

import re
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from benchmarks.chromium import DESKTOP, PHONE, errors, fetched, resize, scrolls_sideways

from insonify.mission.tables import Campaign
from insonify.report.campaign_html import write_campaign_report

pytestmark = pytest.mark.slow


def _campaign(seeds: int) -> Campaign:
    """Two mappers that do as well, two planners of which one gains 0.2."""
    rng = np.random.default_rng(3)
    curves, runs = [], []
    mappers, planners = ("bayes", "own.py:Wary"), ("entropy", "uniform")
    for mapper, planner, seed in product(mappers, planners, range(seeds)):
        names = {
            "run": f"{mapper}{planner}{seed}", "scenario": "wreck", "sonar": "park-2025",
            "model": "cerqueira", "navigation": "none", "mapper": mapper, "planner": planner,
            "seed": seed, "time_s": np.nan, "oracle_exact_recall": 0.25,
        }  # fmt: skip
        score = 0.4 + 0.2 * (planner == "entropy") + 0.01 * rng.random()
        moments = [
            {"scan": k, "pings": 9 * k, "path_m": 20.0 * k, "solid_exact_f1": score * k / 3}
            for k in (1, 2, 3)
        ]
        curves += [names | moment for moment in moments]
        runs.append(names | moments[-1] | {"scans": 3})
    failed = {"scenario": "wreck", "planner": "<odd>", "message": "no <way>", "traceback": ""}
    tables = (pd.DataFrame(runs).drop(columns="scan"), pd.DataFrame(curves), pd.DataFrame())
    return Campaign("Wrecks & more", *tables, (failed,))


def _text(page: str) -> str:
    return " ".join(re.sub(r"<[^>]*>", " ", page).split())


def test_it_shows_curves_figures_tests_and_failures(tmp_path: Path) -> None:
    write_campaign_report(_campaign(4), tmp_path / "r.html")
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert not re.search(r"""(src|href)=["'](?!data:)""", page)
    for section in ("setting-1", "tests", "failed"):
        assert f'<section id="{section}">' in page
    text = _text(page)
    assert "Wrecks &amp; more" in text and "no &lt;way&gt;" in text
    assert "bayes / entropy bayes / uniform Wary / entropy Wary / uniform" in text
    assert "recall (oracle, exact) 0.250 ± 0.000" in text
    found = re.search(
        r"entropy - uniform wreck, park-2025, cerqueira, none, bayes 4 \+0\.(\d+)", text
    )
    assert found and 190 <= int(found[1]) <= 210
    assert text.count("entropy - uniform") == text.count("bayes - Wary") == 2 * 3
    assert page.count('class="sure"') >= 6


def test_one_seed_has_no_bands_and_no_p(tmp_path: Path) -> None:
    write_campaign_report(_campaign(1), tmp_path / "r.html")
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert 'class="sure"' not in page and " ± 0." not in page


@pytest.mark.parametrize("size", [DESKTOP, PHONE])
def test_it_opens_in_chromium_without_an_error(
    tmp_path: Path, browser: Any, size: tuple[int, int]
) -> None:
    write_campaign_report(_campaign(3), tmp_path / "r.html")
    resize(browser, size)
    browser.get((tmp_path / "r.html").as_uri())
    assert errors(browser) == [] and fetched(browser) == []
    assert not scrolls_sideways(browser, size[0])
    widths = browser.execute_script("return [...document.images].map(i => i.naturalWidth)")
    assert len(widths) == 2 and min(widths) > 500
