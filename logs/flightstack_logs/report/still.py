"""A page without scripts: what the pages of campaigns, explorations and the paper have in common."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from importlib import resources

from flightstack_logs.report.page import asset

_POLICY = "default-src 'none'; style-src 'unsafe-inline'"


def still_page(
    title: str, subtitles: Sequence[str], body: str, *, state: str, verdict: str, footer: str, css: tuple[str, str],
    policy: str = "",
) -> str:  # fmt: skip
    """One self-contained HTML page; words are escaped here, `body` and `footer` are HTML.

    state: good, bad or partly, how the head looks.  css: (package, file) of the page's own style.  policy: what it may
    load besides styles.
    """
    package, file = css
    style = asset("page.css") + "\n" + resources.files(package).joinpath(file).read_text(encoding="utf-8")
    under = "".join(f'<p class="subtitle">{escape(words)}</p>' for words in subtitles)
    return "".join([
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">',
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}{policy}">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        '<meta name="color-scheme" content="light dark">',
        f"<title>{escape(title)}</title><style>{style}</style></head><body>",
        f'<header class="{state}"><span class="verdict">{escape(verdict)}</span>',
        f"<h1>{escape(title)}</h1>{under}</header>",
        f"{body}<footer>{footer}</footer></body></html>\n",
    ])  # fmt: skip
