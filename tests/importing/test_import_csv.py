"""What stands in the cells of CSV files."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foreign_tables import account, imported, lengths, refusal

CHOICES = {"discrete": {"field": "u", "names": ["1", "2", "3"]}}


@pytest.fixture(autouse=True)
def _in_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def lines(cell: str | None = None, *, quoted: bool = False, separator: str = ",") -> None:
    """Write 20 rows of which `q` of row 7, in line 9, is `cell`."""
    mark = '"' if quoted else ""
    table = [["q", "u"], *([f"{i / 4}", f"{i % 3}"] for i in range(20))]
    if cell is not None:
        table[8][0] = cell
    text = [separator.join(f"{mark}{each}{mark}" for each in row) for row in table]
    Path("a.csv").write_text("\n".join(text) + "\n")


@pytest.mark.parametrize("cell", ["nan", "null", "NA", "None", "", "N/A", "NaN", "inf", " nan "])
@pytest.mark.parametrize("quoted", [False, True])
def test_a_missing_value_is_dropped_and_counted_and_what_follows_is_another_episode(cell: str, quoted: bool) -> None:
    lines(cell, quoted=quoted)
    transitions = imported()
    assert lengths(transitions) == [6, 11]
    assert transitions.observation[:, 0].tolist() == [i / 4 for i in range(19) if i not in (6, 7)]
    assert (account()["totals"]["rows"], account()["totals"]["not_finite"]) == (20, 1)


def test_a_plus_sign_is_read_as_such() -> None:
    lines("+3")
    transitions = imported()
    assert lengths(transitions) == [19]
    assert transitions.observation[7, 0] == 3.0


@pytest.mark.parametrize("cell", ["abc", "1,5", "0x10", "1.2.3", "−3"])
def test_a_cell_that_is_no_number_is_named_with_its_line(cell: str) -> None:
    lines(cell, quoted=True)
    assert f"a.csv: line 9, column 'q': '{cell}' is not a number" in refusal()


def test_the_line_counts_comments_and_empty_lines_and_cells_of_several_lines() -> None:
    Path("a.csv").write_text('# made by a logger\n\nq,u,note\n0,0,"two\nlines"\n# pause\n1,1,\n\nabc,1,\n')
    assert "a.csv: line 9, column 'q': 'abc' is not a number" in refusal(comment="#")


def test_a_header_that_stands_twice_is_called_so() -> None:
    lines()
    Path("a.csv").write_text(Path("a.csv").read_text() * 2)
    assert "a.csv: line 22, column 'q': 'q' is the column's own name" in refusal()


def test_true_and_false_are_one_and_zero_as_before() -> None:
    Path("a.csv").write_text("q,u\n0,true\n1,False\n2,\n3,true\n4,true\n")
    assert imported().action[:, 0].tolist() == [1.0, 1.0]


def test_blanks_beside_a_separator_do_not_count() -> None:
    lines(separator=" , ")
    blanks = imported()
    lines(separator=",")
    np.testing.assert_array_equal(blanks.observation, imported().observation)


def test_quotes_after_a_blank_do_not_count() -> None:
    Path("a.csv").write_text('q, "u"\n0, "0"\n1, " 1 "\n2, "2"\n')
    assert imported().action[:, 0].tolist() == [0.0, 1.0]


def test_separator_decimal_sign_comments_and_marks_can_be_chosen() -> None:
    Path("a.csv").write_text("% a\nq;u\n0,25;1\n-;1\n0,5;1\n% b\n1,5;nan\n2e1;1\n3;1\n")
    transitions = imported(separator=";", decimal=",", comment="%", missing=["-", "nan"])
    assert transitions.observation[:, 0].tolist() == [20.0]
    assert account()["totals"]["not_finite"] == 2


def test_a_point_between_thousands_is_not_taken_for_a_decimal_sign() -> None:
    Path("a.csv").write_text("q;u\n1.234;1\n0,5;1\n")
    assert "line 2, column 'q': '1.234' is not a number" in refusal(separator=";", decimal=",")


def test_a_separator_that_is_not_the_one_of_the_file_is_suggested() -> None:
    lines(separator=";")
    assert "give the source separator: ';'" in refusal()


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("q,u\n0,1\n0,1,2\n", "line 3 has 3 cells, but there are 2 names"),
        ("q,u,q\n0,1,2\n", "two columns have the name 'q'"),
        ("q,u, q\n0,1,2\n", "two columns have the name 'q'"),
    ],
)
def test_a_table_whose_cells_have_no_names_of_their_own_is_refused(text: str, what: str) -> None:
    Path("a.csv").write_text(text)
    assert what in refusal()


def test_a_file_in_another_encoding_is_to_be_saved_in_utf_8() -> None:
    Path("a.csv").write_bytes("q,u\n0,1\n1,µ\n".encode("latin-1"))
    assert "save it in UTF-8" in refusal()


@pytest.mark.parametrize(
    ("cells", "names", "expected"),
    [
        ("1 2 1 3 2", ["1", "2", "3"], [0, 1, 0, 2]),
        ("1.0 2.0 1.0 3.0 2.0", ["1", "2", "3"], [0, 1, 0, 2]),
        ("1 0 1 2 0", ["left", "none", "right"], [1, 0, 1, 2]),
        ("left none left right none", ["left", "none", "right"], [0, 1, 0, 2]),
        ("None NA None NA NA", ["NA", "None"], [1, 0, 1, 0]),
        ("true false true true false", ["true", "false"], [0, 1, 0, 0]),
        ("true false true true false", ["off", "on"], [1, 0, 1, 1]),
    ],
)
@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_actions_are_matched_as_names_where_names_look_like_values(
    cells: str, names: list[str], expected: list[int], kind: str
) -> None:
    import polars

    Path("a.csv").write_text("q,u\n" + "".join(f"{i},{cell}\n" for i, cell in enumerate(cells.split())))
    polars.read_csv("a.csv").write_parquet("a.parquet")
    changes: dict[str, Any] = {"kind": kind, "files": [f"a.{kind}"]}
    assert imported(action={"discrete": {"field": "u", "names": names}}, **changes).action.tolist() == expected


def test_an_action_that_is_none_of_the_numbers_is_refused() -> None:
    Path("a.csv").write_text("q,u\n0,1\n1,0\n2,1\n")
    assert "line 3, column 'u': 0.0 is none of the actions (1, 2, 3)" in refusal(action=CHOICES)


@pytest.mark.parametrize("names", [["1", "1.0"], ["a", "a"]])
def test_actions_of_one_name_are_refused(names: list[str]) -> None:
    lines()
    assert "two actions of 'u' have the same name" in refusal(action={"discrete": {"field": "u", "names": names}})


def test_labels_are_told_apart_as_numbers_if_all_are_and_else_as_texts() -> None:
    Path("a.csv").write_text("q,u,e\n0,0,1\n1,1,1.0\n2,2, 01\n3,3,2\n4,4,2\n")
    assert lengths(imported(episode={"by": "column", "column": "e"})) == [2, 1]
    Path("a.csv").write_text("q,u,e\n0,0,1e5\n1,1,1e5\n2,2,100000\n3,3,100000\n4,4,x\n5,5,x\n")
    assert lengths(imported(episode={"by": "column", "column": "e"})) == [1, 1, 1]


def test_empty_lines_are_no_rows_but_rows_without_values_are() -> None:
    rows = [f"{i},{i % 3}" for i in range(6)]
    Path("a.csv").write_text("\n\nq,u\n" + "\n\n".join(rows[:3]) + "\n,\n" + "\n\n".join(rows[3:]) + "\n\n")
    assert lengths(imported()) == [2, 2]
    assert (account()["totals"]["rows"], account()["totals"]["not_finite"]) == (7, 1)
    Path("a.csv").write_text("q,u\n1,2\n\n\nabc,2\n")
    assert "a.csv: line 5, column 'q': 'abc' is not a number" in refusal()


def test_line_ends_that_a_program_wrote_twice_are_one() -> None:
    Path("a.csv").write_bytes(b"q,u\r\r\n" + b"".join(b"%d,%d\r\r\n" % (i, i % 3) for i in range(6)))
    assert lengths(imported()) == [5]
    assert account()["totals"]["not_finite"] == 0


def test_a_row_without_a_label_is_dropped_and_cuts_its_episode() -> None:
    labels = [0, 0, 0, "", 0, 0, 1, 1]
    Path("a.csv").write_text("q,u,e\n" + "".join(f"{i},{i % 3},{label}\n" for i, label in enumerate(labels)))
    assert lengths(imported(episode={"by": "column", "column": "e"})) == [2, 1, 1]
    assert account()["totals"]["not_finite"] == 1


@pytest.mark.parametrize("value", [2**53, -(2**60) - 1, 2**63 + 5])
def test_a_whole_number_that_float64_cannot_hold_is_refused(value: int) -> None:
    Path("a.csv").write_text("q,u\n" + "".join(f"{i if i < 3 else value + i},{i % 3}\n" for i in range(20)))
    message = refusal(observation={"q": {"field": "q", "offset": float(value)}})
    assert message.startswith(f"a.csv: line 5, column 'q': {value + 3} has more digits than float64 holds; record")
