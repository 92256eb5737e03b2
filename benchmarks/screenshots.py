"""`make screenshots`: flies what the pages of docs/screenshots show, opens each in Chromium and keeps the pictures.

    python -m benchmarks.screenshots [DIR]

Seeds and vehicles are fixed, so that only what the pages look like changes from one run to the next (and the times that
they tell).
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
SIZE = "1440,1000"
LOADED = "[effects.payload]\nmass_kg = 0.25\n[effects.rotor_drag]\nk_d_kg_per_rad = 1.6e-4\n"


def flightstack(*words: str | Path) -> None:
    """One call of the command line; what it says goes to the terminal."""
    subprocess.run([sys.executable, "-m", "flightstack", *map(str, words)], check=True)


def pages(folder: Path) -> dict[str, Path]:
    """Fly, certify, find a gap: the page of each, by the picture's name."""
    vehicle = ROOT / "flightstack" / "data" / "vehicles" / "quad-x.toml"
    truth = folder / "truth.toml"
    truth.write_text(vehicle.read_text(encoding="utf-8") + LOADED, encoding="utf-8")
    flightstack("fly", "paper-tracking", "--seed", "0", "--out", folder / "fly")
    flightstack("certify", "--seed", "0", "--out", folder / "certify")
    flightstack("fly", "figure8", "--no-learning", "--truth", truth, "--seed", "0", "--out", folder / "loaded")
    flightstack("gap", folder / "loaded" / "flight.mcap", "--vehicle", "quad-x", "--out", folder / "gap")
    return {name: folder / name / "report.html" for name in ("fly", "certify", "gap")}


def take(browser: str, page: Path, picture: Path) -> None:
    """The page's upper part, as a reader sees it first."""
    with tempfile.TemporaryDirectory() as profile:
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--virtual-time-budget=4000"]
        named = [f"--window-size={SIZE}", f"--user-data-dir={profile}", f"--screenshot={picture}", page.as_uri()]
        subprocess.run([browser, *options, *named], check=True, capture_output=True, timeout=120)


def main(out: Path) -> None:
    """Every picture, into `out`."""
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if browser is None:
        sys.exit(f"error: no browser; install one of {', '.join(BROWSERS)}")
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        for name, page in pages(Path(folder)).items():
            take(browser, page, out / f"{name}.png")
            print(out / f"{name}.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "screenshots")
