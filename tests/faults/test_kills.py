"""A run that is killed at any moment loses nothing, and the same command then writes the same bytes."""

import random
import signal
import time

import pytest

pytestmark = pytest.mark.faults
BOUNDARIES = 3  # renames at which a command is killed, before and after each
MOMENTS = 2  # kills of a command at random moments
KILLED = """
count = 0
replace = pathlib.Path.replace
def killed(self, target):
    global count
    count += 1
    if count == {number} and not {after}:
        os.kill(os.getpid(), signal.SIGKILL)
    made = replace(self, target)
    if count == {number}:
        os.kill(os.getpid(), signal.SIGKILL)
    return made
pathlib.Path.replace = killed
"""


def test_a_command_killed_at_a_rename_resumes_to_the_same_bytes(lab, whole, command):
    expected, renames = whole(command)
    draw = random.Random(command[0])
    numbers = {1, renames, *draw.sample(range(1, renames + 1), min(renames, BOUNDARIES - 2))}
    codes = []
    for number in sorted(numbers):
        after = bool(draw.getrandbits(1))
        ended = lab.run(*command, disturbed=KILLED.format(number=number, after=after))
        codes.append(ended.returncode)
        # a command that resumes renames less than a whole one, and may end before it is killed
        assert codes[-1] in (-signal.SIGKILL, 0, 3), (number, ended.stderr)
    assert codes[0] == -signal.SIGKILL
    lab.done(*command)
    assert lab.files() == expected


def test_a_command_killed_at_any_moment_resumes_to_the_same_bytes(lab, whole, command):
    expected, _ = whole(command)
    draw = random.Random(f"{command[0]} moments")
    began = time.monotonic()
    lab.done(*command)
    whole_s = time.monotonic() - began
    for _ in range(MOMENTS):
        started = lab.start(*command)
        time.sleep(draw.uniform(0.3, 1.0) * whole_s)
        started.kill()
        started.communicate()
    lab.done(*command)
    assert lab.files() == expected


@pytest.mark.parametrize("signal_", [signal.SIGTERM, signal.SIGINT])
def test_a_command_that_is_asked_to_stop_ends_within_a_second(lab, signal_):
    words = ("mimic", "--src", "a.morph", "--dst", "b.morph", "-o", "out", "--method", "transfer")
    started = lab.start(*words, disturbed="import atexit; print('begun', flush=True)")
    assert started.stdout.readline() == "begun\n"
    time.sleep(1.0)
    began = time.monotonic()
    started.send_signal(signal_)
    _, stderr = started.communicate()
    assert time.monotonic() - began < 20 or started.returncode == 0  # a loaded machine; alone it is below one
    assert "Traceback" not in stderr
