"""A run that is killed at any moment loses nothing, and the same command then writes the same bytes."""

import random
import signal
import time

import cv2
import numpy as np
import pytest

from morphspace.io.images import read_image, write_image

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


DEAF_S = 1.0  # s of processor time, of all threads; a whole build at 800 x 960 px has .2 s at most
CHECKED = """
import atexit, time
last, widest = time.process_time(), 0.0
def checked(number, frame):
    global last, widest
    widest, last = max(widest, time.process_time() - last), time.process_time()
def told():
    signal.setitimer(signal.ITIMER_REAL, 0)
    print("widest", widest, file=sys.stderr)
signal.signal(signal.SIGALRM, checked)
signal.setitimer(signal.ITIMER_REAL, 0.01, 0.01)
atexit.register(told)
"""
STOPPED = """
import atexit, time
asked = []
def ask(number, frame):
    asked.append(time.process_time())
    os.kill(os.getpid(), {signal_})
signal.signal(signal.SIGPROF, ask)
signal.setitimer(signal.ITIMER_PROF, {after_s})
atexit.register(lambda: print("took", *(time.process_time() - one for one in asked), file=sys.stderr))
"""
BIG = ("build-model", "big", "-o", "out/m.morph", "--landmarks", "none")


@pytest.fixture
def big(lab):
    """A lab with a clip of 800 x 960 px."""
    for path in sorted((lab.folder / "actors" / "actor_01").glob("*.png"))[:4]:
        frame = cv2.resize(read_image(path), (800, 960), interpolation=cv2.INTER_CUBIC)
        write_image(lab.folder / "big" / path.name, np.clip(frame, 0, 1))
    return lab


def test_no_call_is_deaf_to_signals_for_a_second(big):
    """Python runs the handler of a signal between two calls of OpenCV or NumPy: the longest call is the gap."""
    for words in (
        BIG,
        ("mimic", "--src", "a.morph", "--dst", "b.morph", "-o", "out", "--method", "transfer"),
    ):
        ended = big.run(*words, disturbed=CHECKED)
        assert ended.returncode in (0, 3), ended.stderr
        widest_s = float(ended.stderr.rsplit("widest ", 1)[1])
        assert 0 < widest_s < DEAF_S


@pytest.mark.parametrize("signal_", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("after_s", [0.5, 2, 5])  # while packages are imported, and in the midst of the build
def test_a_command_that_is_asked_to_stop_does_little_more(big, signal_, after_s):
    ended = big.run(*BIG, disturbed=STOPPED.format(signal_=int(signal_), after_s=after_s))
    assert ended.returncode == 130, ended.stderr
    assert "morphspace: stopped" in ended.stderr and "Traceback" not in ended.stderr
    assert float(ended.stderr.rsplit("took ", 1)[1]) < DEAF_S
