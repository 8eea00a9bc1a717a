"""Commands of many flights: bad input is one line before anything is flown."""

import pytest

from sim_bridge.__main__ import main


@pytest.mark.parametrize(("arguments", "words"), [
    (["integrity", "--flights", "0"], "--flights 0: must be at least 1"),
    (["consistency", "--processes", "0"], "--processes 0: must be at least 1"),
    (["accuracy", "--first-seed", "-1"], "--first-seed -1: must be at least 0"),
])
def test_numbers_that_cannot_be(capsys, arguments, words):
    assert main(arguments) == 2
    assert capsys.readouterr().err == f"sim-bridge: {words}\n"


def test_a_folder_that_cannot_be_is_told_before_the_flights(tmp_path, capsys):
    taken = tmp_path / "taken"
    taken.write_text("")
    assert main(["integrity", "--out", str(taken)]) == 2
    assert capsys.readouterr().err == f"sim-bridge: --out {taken}: File exists\n"
