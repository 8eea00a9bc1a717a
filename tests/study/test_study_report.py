"""The command, its report and its numbers."""

import base64
import json
import math
import struct
from html.parser import HTMLParser

import pytest

import sim_bridge.__main__
from sim_bridge.study import report
from sim_bridge.study.command import PARTS, Options, chosen, study
from sim_bridge.study.section import Picture, Section, Table

NUMBERS = {"7.1", "7.2", "7.3", "7.4", "7.5.1", "7.5.2", "7.5.3", "7.5.4", "7.6"}


class Page(HTMLParser):
    """What is on a page: pictures, tables, rows of the thesis, and whether tags close."""

    def __init__(self, text):
        super().__init__()
        self.images, self.tables, self.thesis_rows, self.text, self.open = [], 0, 0, [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        if tag not in {"meta", "img"}:
            self.open.append(tag)
        if tag == "img":
            self.images.append(attributes["src"])
        self.tables += tag == "table"
        self.thesis_rows += tag == "tr" and attributes.get("class") == "thesis"

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def size_of_png(data):
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    return struct.unpack(">II", data[16:24])


def numbers_in(data):
    if isinstance(data, dict):
        return [n for value in data.values() for n in numbers_in(value)]
    if isinstance(data, list):
        return [n for value in data for n in numbers_in(value)]
    return [data] if isinstance(data, int | float) else []


def look_over(folder, numbers):
    page = Page((folder / "report.html").read_text(encoding="utf-8"))
    assert page.open == []
    data = json.loads((folder / "numbers.json").read_text(encoding="utf-8"))
    assert set(data) == numbers | {"about"}
    tables = [table for number in numbers for table in data[number]["tables"]]
    assert page.tables == len(tables)
    assert page.thesis_rows == sum(len(table["thesis_rows"]) for table in tables)
    for table in tables:
        assert table["rows"]
        assert all(len(row) == len(table["columns"]) for row in table["rows"])
    assert all(math.isfinite(n) for n in numbers_in(data))
    drawn = sorted(p.read_bytes() for p in (folder / "pictures").glob("*.png"))
    shown = sorted(base64.b64decode(src.removeprefix("data:image/png;base64,"), validate=True) for src in page.images)
    assert drawn == shown
    assert all(min(size_of_png(png)) > 200 for png in shown)
    assert all(data[number]["differences"] for number in numbers)
    return data


def test_a_part_of_the_study_is_flown_and_reported(tmp_path, capsys):
    out = tmp_path / "study"
    code = sim_bridge.__main__.main(
        ["study", "--quick", "--seed", "1002", "--only", "swap,convergence,delay", "--out", str(out)]
    )
    assert code == 0
    said = capsys.readouterr()
    assert said.out == f"report: {out / 'report.html'}\n"
    assert said.err == ""
    data = look_over(out, {"7.3", "7.5.2", "7.5.4"})
    intervals = data["7.5.4"]["intervals"]["GLSDC"]
    assert intervals["translation_m"][0] < 0.0 < intervals["translation_m"][1]


@pytest.mark.slow
def test_the_whole_study_is_reported(tmp_path):
    page = study(Options(seed=1003, out=str(tmp_path), quick=True))
    assert page == tmp_path / "report.html"
    data = look_over(tmp_path, NUMBERS)
    assert data["7.1"]["glsdc_steps_that_explain_the_thesis"] == pytest.approx(3.0, abs=0.1)
    chain = [row[-1] for row in data["7.5.1"]["tables"][0]["rows"] if not row[0].startswith("thesis")]
    assert chain == [0] * len(chain)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--only", "swop"], "--only 'swop': no such part; there are flops, timing"),
        (["--only", ""], "no such part"),
        (["--seed", "-1"], "--seed -1: must not be negative"),
        (["--out", "/proc/nothing"], "--out /proc/nothing: cannot be written"),
        (["--out", __file__], "cannot be written"),
    ],
)
def test_bad_input_is_one_line(arguments, says, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert sim_bridge.__main__.main(["study", *arguments]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert says in said.err
    assert not list(tmp_path.rglob("*.html"))


def test_a_seed_that_is_no_number_is_one_line(capsys):
    with pytest.raises(SystemExit) as stop:
        sim_bridge.__main__.main(["study", "--seed", "one"])
    assert stop.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_parts_come_in_the_order_of_the_thesis():
    assert chosen(None) == list(PARTS)
    assert chosen("swap, flops") == ["flops", "swap"]


def test_help_names_every_part(capsys):
    with pytest.raises(SystemExit):
        sim_bridge.__main__.main(["study", "--help"])
    said = capsys.readouterr().out.split()
    assert all(any(word.strip(",.") == part for word in said) for part in PARTS)


def test_text_on_the_page_cannot_break_it(tmp_path):
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "a.png").write_bytes(b"a picture")
    table = Table("<b>", ("a & b", '"'), (("<script>", 1e-9), ("x", 12345678)), (1,))
    section = Section("7", "a < b", "'&", (table,), (Picture("a.png", '">'),), ("</ul>",))
    page = Page(report.write(tmp_path, [section], [("x", "<y>")]).read_text(encoding="utf-8"))
    assert page.open == []
    assert page.tables == 1
    assert "<script>" in page.text
    assert "12\u202f345\u202f678" in page.text


def test_numbers_that_are_none_are_not_written(tmp_path):
    (tmp_path / "pictures").mkdir()
    bad = Section("7", "t", "m", (Table("t", ("a",), ((float("nan"),),)),))
    with pytest.raises(ValueError, match="JSON"):
        report.write(tmp_path, [bad], [])
