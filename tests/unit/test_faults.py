"""The fault table: the document says the same, every row has a test, and every reaction is one that exists."""

from __future__ import annotations

import ast
import configparser
import re
from pathlib import Path

import pytest

from mavlink_bridge.faults import FAULTS, Reaction
from mavlink_bridge.handshake import TRANSITIONS, HandshakeEvent, State

ROOT = Path(__file__).resolve().parents[2]
SAFETY, COMPANION = ROOT / "docs" / "safety.md", ROOT / "docs" / "companion.md"


def test_the_document_holds_the_table_as_it_is() -> None:
    lines = ["| fault | noticed | reaction | after | test |", "| --- | --- | --- | --- | --- |"]
    for name, fault in FAULTS.items():
        after = "-" if fault.after_s is None else f"{fault.after_s:.3g} s"
        noticed = fault.noticed.replace("|", "\\|")
        lines.append(f"| **{name}**: {fault.what} | {noticed} | {fault.reaction.value} | {after} | `{fault.test}` |")
    found = SAFETY.read_text().partition("<!-- faults -->\n")[2].partition("<!-- end -->")[0]
    assert found == "\n".join(lines) + "\n"


@pytest.mark.parametrize("name", FAULTS)
def test_every_row_names_a_test_that_exists(name: str) -> None:
    file, _, test = FAULTS[name].test.partition("::")
    tree = ast.parse((ROOT / "tests" / file).read_text())
    assert test in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


@pytest.mark.parametrize("name", FAULTS)
def test_the_test_of_a_row_really_is_about_it(name: str) -> None:
    """A test file mentions the row, or the row's test is its own."""
    file = FAULTS[name].test.partition("::")[0]
    shared = sum(row.test == FAULTS[name].test for row in FAULTS.values()) > 1
    assert not shared or f'"{name}"' in (ROOT / "tests" / file).read_text()


def test_each_hand_back_leads_to_px4_and_out_of_the_flight() -> None:
    flying = TRANSITIONS[State.OFFBOARD]
    assert flying[HandshakeEvent.FAULT_LAND] is State.LANDING
    assert flying[HandshakeEvent.FAULT_HOLD] is State.HOLDING
    assert {row.reaction for row in FAULTS.values()} == set(Reaction)


def _blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", COMPANION.read_text(), re.DOTALL)


def test_the_documented_service_never_arms_and_is_never_restarted_in_flight() -> None:
    (text,) = _blocks("ini")
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    unit.read_string(text)
    service = unit["Service"]
    assert "--arm" not in service["ExecStart"].split()
    assert service["Restart"] == "no"
    assert service["KillSignal"] == "SIGTERM"  # lands
    assert int(service["TimeoutStopSec"]) >= 60  # time to land before SIGKILL


def test_the_documented_commands_are_understood(capsys: pytest.CaptureFixture[str]) -> None:
    from flightstack.cli import main as cli

    with pytest.raises(SystemExit):
        cli.main(["offboard", "--help"])
    offered = set(re.findall(r"--[a-z-]+", capsys.readouterr().out))
    used = {option for block in _blocks("sh") + _blocks("ini") for line in block.splitlines()
            if "flightstack offboard" in line for option in re.findall(r"(--[a-z-]+)", line)}  # fmt: skip
    assert used
    assert used <= offered
