"""A disk that is full refuses in one line and leaves what was there."""

import random

import pytest

pytestmark = pytest.mark.faults
FULL = """
count = 0
def full(handle):
    global count
    count += 1
    if count >= {number}:
        raise OSError(28, "No space left on device")
os.fsync = full
"""


def test_a_full_disk_ends_in_one_line_and_keeps_earlier_files(lab, whole, command):
    expected, renames = whole(command)
    draw = random.Random(f"{command[0]} disk")
    lab.done(*command)
    assert lab.files() == expected
    for number in (1, draw.randint(2, renames + 1)):
        ended = lab.run(*command, disturbed=FULL.format(number=number))
        said = [line for line in ended.stderr.splitlines() if line.startswith("morphspace: ")]
        # a set whose stimuli are complete writes few files again, so that a late fault may never come
        assert ended.returncode == 2 or (number > 1 and ended.returncode in (0, 3)), ended.stderr
        assert len(said) == (ended.returncode == 2) and "Traceback" not in ended.stderr
        kept = lab.files()
        assert {file: kept.get(file) for file in expected} == expected
    lab.done(*command)
    assert lab.files() == expected
