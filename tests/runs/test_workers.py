"""Workers: order of results, what kills one of them, Ctrl-C. Nothing heavy is imported, since each worker does too."""

import os
import signal
import subprocess
import sys
import time

import msgspec
import psutil

from sim_bridge.runs.many import Crashed, Job, fly_many
from sim_bridge.scenario import load_scenario


def jobs_of(*seeds):
    scenario = load_scenario("docking")
    setup = scenario.setup()
    return [Job(str(seed), msgspec.structs.replace(scenario, seed=seed), setup) for seed in seeds]


def slower_first(job):
    time.sleep(0.05 * max(0, 3 - job.scenario.seed))
    return job.scenario.seed, os.getpid()


def dies(job):
    if job.scenario.seed == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    if job.scenario.seed == 4:
        sys.exit(7)
    return job.scenario.seed


def test_results_come_in_the_order_of_the_jobs_and_from_both_workers():
    told = []
    found = fly_many(jobs_of(*range(6)), slower_first, processes=2, tell=told.append)
    assert [seed for seed, _ in found] == list(range(6))
    pids = {pid for _, pid in found}
    assert len(pids) == 2
    assert os.getpid() not in pids
    assert len(told) == 6
    assert told[-1].startswith("6/6 ")
    assert not any(psutil.pid_exists(pid) for pid in pids)


def test_a_flight_that_kills_its_worker_is_named_and_the_rest_goes_on():
    told = []
    found = fly_many(jobs_of(*range(1, 7)), dies, processes=2, tell=told.append)
    assert [f for f in found if not isinstance(f, Crashed)] == [1, 3, 5, 6]
    assert found[1] == Crashed("2", "signal 9")
    assert found[3] == Crashed("4", "exit code 7")
    assert sum("crashed" in line for line in told) == 2


def test_no_flights_are_no_results():
    assert fly_many([], dies) == []


def test_ctrl_c_ends_the_flights_and_leaves_nobody_behind():
    command = [sys.executable, "-m", "sim_bridge", "integrity", "--flights", "50", "--first-seed", "1000"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True) as process:
        try:
            until = time.monotonic() + 120
            while len(children := psutil.Process(process.pid).children(recursive=True)) < 2:
                assert time.monotonic() < until
                time.sleep(0.1)
            time.sleep(2.0)
            os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the children too
            out, err = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode == 130
    assert out == b""
    assert b"Traceback" not in err
    assert not psutil.wait_procs(children, timeout=10)[1]
