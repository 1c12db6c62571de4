"""When everybody is silent it is our own link: nobody is given up for that, and nobody is forgotten either."""

from skyfolio.api.fleet.own_link import Heard, OwnLink

LOST_AFTER_S, STALE_AFTER_S = 5.0, 3.0
STEP_S = 0.25


class Sky:
    """Vehicles that are heard, or not, in virtual time."""

    def __init__(self, *uavs: str, others: tuple[str, ...] = ()) -> None:
        self.link = OwnLink(stale_after_s=STALE_AFTER_S, lost_after_s=LOST_AFTER_S)
        self.now_s = 100.0
        self.lost: dict[str, float] = {}
        self._uavs, self._others = uavs, others
        self._heard_s = dict.fromkeys((*uavs, *others), self.now_s)

    def is_dark(self) -> bool:
        return self.link.silent_since_s is not None

    def fly(self, seconds: float, *, silent: tuple[str, ...] = ()) -> None:
        for _ in range(round(seconds / STEP_S)):
            self.now_s += STEP_S
            self._heard_s |= {one: self.now_s for one in self._heard_s if one not in silent}
            counting = {uav: self._how(uav) for uav in self._uavs if uav not in self.lost}
            others = [self._how(one) for one in (*self._others, *self.lost)]
            for uav in self.link.judge(counting, others, self.now_s):
                self.lost[uav] = round(self.now_s - self._heard_s[uav], 1)

    def _how(self, one: str) -> Heard:
        silent_s = self.now_s - self._heard_s[one]
        return Heard(silent_for_s=silent_s, lost=silent_s >= LOST_AFTER_S)


def test_one_that_is_silent_while_another_is_heard_is_lost_in_time() -> None:
    sky = Sky("a", "b")
    sky.fly(20, silent=("a",))
    assert sky.lost == {"a": 5.0}
    assert not sky.is_dark()


def test_all_silent_at_once_is_our_link_and_nobody_is_lost_when_they_are_heard_again() -> None:
    sky = Sky("a", "b", "c")
    sky.fly(4.75, silent=("a", "b", "c"))
    assert not sky.is_dark()
    sky.fly(60, silent=("a", "b", "c"))
    assert sky.is_dark()
    assert sky.link.silent_since_s == 100.0
    sky.fly(1)
    assert not sky.is_dark()
    assert sky.lost == {}


def test_who_does_not_come_back_with_the_others_is_lost_when_it_was_waited_for() -> None:
    sky = Sky("a", "b", "c")
    sky.fly(30, silent=("a", "b", "c"))
    sky.fly(4.75, silent=("c",))
    assert sky.is_dark()
    sky.fly(0.5, silent=("c",))
    assert set(sky.lost) == {"c"}
    assert not sky.is_dark()


def test_a_link_that_comes_and_goes_gives_nobody_up() -> None:
    sky = Sky("a", "b")
    for _ in range(10):
        sky.fly(20, silent=("a", "b"))
        sky.fly(1, silent=("b",))
    assert sky.lost == {}


def test_another_vehicle_that_is_heard_shows_that_the_link_works() -> None:
    sky = Sky("a", "b", others=("on the ground",))
    sky.fly(20, silent=("a", "b"))
    assert sky.lost == {"a": 5.0, "b": 5.0}


def test_a_single_uav_and_the_last_one_left_are_never_given_up_for_silence() -> None:
    alone = Sky("a")
    alone.fly(60, silent=("a",))
    assert alone.is_dark()
    assert alone.lost == {}
    last = Sky("a", "b")
    last.fly(20, silent=("a",))
    last.fly(20, silent=("a", "b"))
    assert last.is_dark()
    assert last.lost == {"a": 5.0}


def test_two_killed_one_after_the_other_are_two_losses() -> None:
    sky = Sky("a", "b", "c")
    sky.fly(2.5, silent=("a",))
    sky.fly(10, silent=("a", "b"))
    assert sky.lost == {"a": 5.0, "b": 5.0}


def test_one_that_is_heard_again_but_not_for_long_enough_yet_is_not_lost() -> None:
    link = OwnLink(stale_after_s=STALE_AFTER_S, lost_after_s=LOST_AFTER_S)
    dark, back = Heard(silent_for_s=10.0, lost=True), Heard(silent_for_s=0.2, lost=False)
    assert link.judge({"a": dark, "b": dark}, [], 100.0) == []
    coming = Heard(silent_for_s=0.5, lost=True)
    for step in range(40):
        assert link.judge({"a": back, "b": coming}, [], 101.0 + step * STEP_S) == []
    assert not link.is_lost
    assert link.judge({"a": back, "b": Heard(silent_for_s=STALE_AFTER_S, lost=True)}, [], 114.0) == ["b"]
