"""Gains that a ground station changes in flight are told: on a real PX4 the shield flew on with three times its rate
gains, changed three commands of five, and said nothing."""

from __future__ import annotations

from pathlib import Path

from shield_rig import SITE, Rig, position

from flightstack.cli.shield_premises import ShieldPremises
from flightstack.cli.vehicle_gains import counted_on
from mavlink_bridge import messages as m

REAL32 = 9


def test_what_the_program_sets_through_the_shield_is_told_once_and_so_is_its_end(tmp_path: Path) -> None:
    site = tmp_path / "room.toml"
    site.write_text(SITE)
    rig = Rig(site)
    rig.router.premises = ShieldPremises(counted_on(rig.believed))
    rig.say = lambda: position(0.0, 0.0, -2.0)
    rig.run(3.0)

    def told(name: str, value: float) -> list[str]:
        rig.program.send(m.ParamSet(1, 1, name, m.param_bits(value, REAL32), REAL32))
        rig.run(0.5)
        return rig.router.premises.look()

    assert not told("MPC_XY_VEL_MAX", 3.0), "nothing counts on it"
    (line,) = told("MC_ROLLRATE_P", 0.45)
    assert line.startswith("MC_ROLLRATE_P is 0.45 now, the site's certificate counts on 0.15: ")
    assert not told("MC_ROLLRATE_P", 0.45)
    assert len(told("THR_MDL_FAC", 0.5)) == 1
    (line,) = told("MC_ROLLRATE_P", 0.15)
    assert "is 0.15 again" in line
    assert line.endswith("THR_MDL_FAC still not")
    assert rig.router.premises.changed == {"MC_ROLLRATE_P", "THR_MDL_FAC"}


def test_a_program_that_asks_for_slow_streams_does_not_blind_the_shield(tmp_path: Path) -> None:
    """A real PX4 obeyed it: attitude once a second, nothing flown, the dead-man's Hold."""
    site = tmp_path / "room.toml"
    site.write_text(SITE)
    rig = Rig(site)
    rig.take_off()
    for seconds in (0.4, 1.1, 2.3):
        for number in (31, 32, 105):  # ATTITUDE_QUATERNION, LOCAL_POSITION_NED, HIGHRES_IMU
            rig.command(511, float(number), 1e6)
        silent = 0
        for _ in range(round(250 * seconds)):
            rig.run(0.004)
            silent += not rig.router.has_spoken
        assert not silent, "ticks without a setpoint"
