"""Helpers that stay on their core while they sleep, and those who make way for them."""

from __future__ import annotations

import pytest
from support.processes import run_process

from wrt.kernels.compilation.cores import available_cores

pytestmark = pytest.mark.skipif(available_cores() < 2, reason="one core")

HEAD = """
from wrt.kernels.runtime import job_queue
everywhere = os.sched_getaffinity(0)
helpers = [thread.native_id for thread in pools.the_pool()._threads]
def cores_of_helpers(asking, seconds=0.5):
    end, seen = time.monotonic() + seconds, []
    while time.monotonic() < end:
        if asking:
            assert (ask() == expected).all()
        seen.append([os.sched_getaffinity(helper) for helper in helpers])
        time.sleep(0.0 if asking else 0.01)
    return seen
"""


@pytest.mark.parametrize("stays", [True, False])
def test_a_sleeping_helper_stays_on_its_core(stays):
    """Only while it sleeps, only if it is to, and no two on one core; what others have done to its cores meanwhile remains."""
    run_process(f"""{HEAD}
pools.the_pool()._words[job_queue.STAYS] = {stays}
assert helpers
assert any(everywhere in cores for cores in cores_of_helpers(True)), "all stay while they work"
asleep = cores_of_helpers(False)[-1]
staying = [cores for cores in asleep if len(cores) == 1]
assert len(staying) == len(set(map(tuple, staying))), asleep
assert all(cores == everywhere for cores in asleep if cores not in staying), asleep
assert bool(staying) == {stays}, asleep
chosen = (everywhere - asleep[0]) or everywhere
chosen = {{min(chosen)}}
os.sched_setaffinity(helpers[0], chosen)
cores_of_helpers(True), cores_of_helpers(False)
assert os.sched_getaffinity(helpers[0]) == chosen
assert any(everywhere in cores[1:] for cores in cores_of_helpers(True)), "the others stay while they work"
""")


def test_who_wakes_a_helper_makes_way_for_it():
    """The caller comes to the core of a sleeper and asks: the sleeper works elsewhere, and has all its cores afterwards."""
    run_process(f"""{HEAD}
pools.the_pool()._words[job_queue.STAYS] = 1
def core_of(thread):
    return int(open(f"/proc/self/task/{{thread}}/stat").read().rsplit(")", 1)[1].split()[36])
elsewhere = 0
for turn in range(20):
    ask()
    asleep = cores_of_helpers(False, 0.05)[-1]
    staying = [(helper, min(cores)) for helper, cores in zip(helpers, asleep) if len(cores) == 1]
    if not staying:
        continue
    helper, core = staying[0]
    os.sched_setaffinity(0, {{core}})
    assert (ask() == expected).all()
    elsewhere += core_of(helper) != core
    os.sched_setaffinity(0, everywhere)
    cores_of_helpers(True, 0.02)
assert elsewhere >= 5, elsewhere
assert any(everywhere == cores[0] for cores in cores_of_helpers(True)), "a moved helper is restricted for good"
""")
