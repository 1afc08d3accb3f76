"""Two runs into one output: one of them is refused, and the files are those of one run."""

import pytest

pytestmark = pytest.mark.faults


def test_of_two_runs_at_once_one_is_refused_or_waits(lab, whole, command):
    expected, _ = whole(command)
    both = [lab.start(*command) for _ in range(2)]
    ends = [(started.communicate()[1], started.returncode) for started in both]
    codes = [code for _, code in ends]
    assert any(code in (0, 3) for code in codes), ends
    for stderr, code in ends:
        assert code in (0, 3) or (code == 2 and "is writing" in stderr), stderr
    assert lab.files() == expected
