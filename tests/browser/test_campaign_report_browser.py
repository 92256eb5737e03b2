"""The campaign's page in a real browser: everything drawn, nothing injected, no wider than a phone."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_report_browser import CHROMIUM, opened

from flightstack.cli.campaign.page import render
from flightstack.cli.campaign.result import assess
from flightstack.cli.campaign.spec import parse_spec

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(not CHROMIUM.exists(), reason="no browser: /usr/bin/chromium is not installed"),
]
HOSTILE = "<img src=x onerror=alert(1)>"
FILE = f"""# {HOSTILE}
schema = "flightstack.campaign/1"
scenario = ["hover", "figure8"]
count = 60
[vary]
"body.mass_kg" = {{low = 1.0, high = 2.0}}
"fly.fault" = ["none", "gps-loss"]
"""
MEASURE = """<script>addEventListener("load", () => {
  document.body.dataset.wide = document.documentElement.scrollWidth - innerWidth; });</script></body>"""


def _page() -> str:
    rng, entries = np.random.default_rng(0), list[dict[str, Any]]()
    for i in range(60):
        mass = float(rng.uniform(1.0, 2.0))
        failed = mass > 1.7
        entries.append({
            "flight": i, "seed": i, "scenario": "hover" if i % 2 else "figure8", "reason": HOSTILE if failed else "",
            "values": {"body.mass_kg": mass, "fly.fault": "none" if i % 3 else "gps-loss"},
            "outcome": "failed" if failed else "completed", "log": None, "report": f"reports/{i:06d}.html",
            "result": {"tracking": {"rmse_m": float(rng.uniform(0.0, mass)), "max_m": 1.0}},
            "timing": {"wall_s": 4.0},
        })  # fmt: skip
    return render(assess(parse_spec(FILE, Path("c.toml")), entries))


def test_the_page_shows_everything_and_fits_a_phone(tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    text = _page()
    page.write_text(text.replace("default-src 'none'", "script-src 'unsafe-inline'").replace("</body>", MEASURE))
    dom, data = opened(page, tmp_path / "profile")
    assert int(data["wide"]) <= 0
    assert dom.count('class="plot"') == 3 + 2  # by factor, and two distributions
    assert "<img" not in dom
    assert "body.mass_kg" in dom
    assert 'href="replays/' in dom
    narrow = page.read_text().replace("<body>", '<body style="width: 390px">')
    page.write_text(narrow.replace("documentElement.scrollWidth - innerWidth", "body.scrollWidth - 390"))
    _, data = opened(page, tmp_path / "profile")
    assert int(data["wide"]) <= 0
    assert not re.search(r"https?://", text)
