"""What a shield says while it routes: why nothing is flown, where nobody would know.  Sans-IO."""

from __future__ import annotations

from flightstack.cli.shield_router import ShieldRouter

UNHEARD_US = 3_000_000
"""As long as the companion's link is given."""
_LOOKED_US = 1_000_000
"""What is so for a moment only is not said."""


class ShieldWords:
    """Looks at the router once in a while; says each thing once, and again after it was over."""

    def __init__(self) -> None:
        self._unheard = self._unplaced = self._lost = False
        self._flying_us = -1
        """Since when the vehicle is armed without a place of the site; -1: it is not."""

    def look(self, router: ShieldRouter, now_us: int) -> list[str]:
        """One line each, at local time `now_us`."""
        if not router.system:
            return []
        told = router.after_stall.look()
        return [
            *self._of_the_link(router, now_us),
            *self._of_the_site(router, now_us),
            *self._of_the_aid(router),
            *told,
        ]

    def _of_the_link(self, router: ShieldRouter, now_us: int) -> list[str]:
        unheard, before = now_us - router.view.heard_at_us > UNHEARD_US, self._unheard
        self._unheard = unheard
        if unheard and not before:
            return [f"nothing heard of the vehicle for {1e-6 * UNHEARD_US:g} s: nothing is flown until it is"]
        return ["the vehicle is heard again"] if before and not unheard else []

    def _of_the_aid(self, router: ShieldRouter) -> list[str]:
        lost, before = router.is_lost and router.flies, self._lost
        self._lost = router.is_lost and (lost or before)
        if not lost or before:
            return []
        return [
            "the satellites are lost, and the estimate is the worse for it: the program is not obeyed, the vehicle is "
            "given to PX4's Hold"
        ]

    def _of_the_site(self, router: ShieldRouter, now_us: int) -> list[str]:
        if not router.view.armed or router.origin_ned_m is not None:
            self._flying_us, self._unplaced = -1, False
            return []
        self._flying_us = now_us if self._flying_us < 0 else self._flying_us
        if self._unplaced or now_us - self._flying_us < _LOOKED_US:
            return []
        self._unplaced = True
        return [
            "the vehicle was armed before the shield heard it, so where its site lies is not known: no setpoint passes "
            "until it has landed and is disarmed (it can't enter OFFBOARD); the site then lies round that place"
        ]
