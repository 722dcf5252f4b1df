"""Malformed inputs end in a line of what is wrong with them; what is valid runs. `fuzz.py` says how."""

from __future__ import annotations

import pytest
from fuzz import counted, fuzz

pytestmark = pytest.mark.hard


@pytest.mark.parametrize(
    ("numbers", "start"),
    [
        (range(500), False),
        (range(20_000, 20_010), True),
        pytest.param(range(10_000), False, marks=pytest.mark.long),
        pytest.param(range(20_000, 20_300), True, marks=pytest.mark.long),
    ],
    ids=["500", "10 processes", "10,000", "300 processes"],
)
def test_no_input_ends_in_a_traceback_a_hang_nan_or_half_a_folder(
    numbers: range, start: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    found = fuzz(numbers, every=5 if len(numbers) <= 500 else 1, start=start)
    with capsys.disabled():
        print(f"\n{counted(found)}")
    assert [finding.number for finding in found] == list(numbers)
    faults = [finding for finding in found if finding.is_fault]
    assert not faults, "\n\n".join(f"{f.number} {f.kind}: {f.verdict}\n{f.words[:2000]}" for f in faults[:10])
    # the generator is worth something: it spoils most of what it makes, and leaves some
    assert 0.02 * len(found) < sum(finding.verdict != "refused" for finding in found) < 0.5 * len(found)
