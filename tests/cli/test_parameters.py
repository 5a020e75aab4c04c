"""Numbers on the command line."""

import click
import pytest

from omnisyn_cli.cli.parameters import FrameRate


@pytest.mark.parametrize(
    ("text", "rate"),
    [("30", 30.0), ("29.97", 29.97), ("30000/1001", 30000 / 1001), ("25/1", 25.0), (24, 24.0), ("1000/1", 1000.0)],
)
def test_frame_rates_are_numbers_or_fractions(text: str, rate: float) -> None:
    assert FrameRate().convert(text, None, None) == rate


@pytest.mark.parametrize(
    "text",
    ["30/0", "0/1", "-30/1", "30/", "/1001", "30/1/1", "a/b", "29.97/1", "1001/1", "nan", "inf", "0",
     f"{10**400}/1", f"{'9' * 5000}/1"],
)  # fmt: skip
def test_what_is_no_frame_rate_is_refused(text: str) -> None:
    with pytest.raises(click.BadParameter):
        FrameRate().convert(text, None, None)
