"""Headers, line numbers, and three numbers as people write them."""

from __future__ import annotations

import io

import numpy as np
import pytest

from fullturn.errors import ReadError
from fullturn.io.text import read_text, three_numbers

POINTS = np.random.default_rng(0).normal(size=(7, 3))
NUMBERED = np.c_[np.arange(7), POINTS]


def read(text: str) -> np.ndarray:
    return read_text(text.encode(), "a.txt").points


def saved(header: str, separator: str = ",", comments: str = "") -> str:
    stream = io.StringIO()
    np.savetxt(stream, NUMBERED, "%.17g", separator, header=header, comments=comments)
    return stream.getvalue()


@pytest.mark.parametrize(
    ("header", "separator"),
    [
        ("id,x,y,z", ","),
        (",x,y,z", ","),
        ("id,X [m],Y [m],Z [m]", ","),
        ("id,x[m],y[m],z[m]", ","),
        ("time,x_m,y_m,z_m", ","),
        ("Timestamp,Points:0,Points:1,Points:2", ","),
        ('"Timestamp","Points:0","Points:1","Points:2"', ","),
        ("i points[0] points[1] points[2]", " "),
        ("intensity,Points_m_XYZ:0,Points_m_XYZ:1,Points_m_XYZ:2", ","),
        (",0,1,2", ","),
        ("label,0,1,2", ","),
        ("label,px,py,pz", ","),
        ("i,pos_x,pos_y,pos_z", ","),
        ("i,Position_X,Position_Y,Position_Z", ","),
        ("i,point_x,point_y,point_z", ","),
        ("i,X Coord.,Y Coord.,Z Coord.", ","),
        ("id;x (mm);y (mm);z (mm)", ";"),
        ("id x (mm) y (mm) z (mm)", " "),
        ("id\tPos X\tPos Y\tPos Z", "\t"),
        ("\tx\ty\tz", "\t"),
        ("//I X Y Z", " "),
        ("% i x y z", " "),
        ("nx x y z", " "),
    ],
)
def test_columns_are_found_by_their_names(header: str, separator: str) -> None:
    np.testing.assert_array_equal(read(saved(header, separator)), POINTS)
    if header[0] not in "/%":
        np.testing.assert_array_equal(read(saved(header, separator, "# ")), POINTS)
        above = f"# a longer comment\n{saved(header, separator, '#')}"
        np.testing.assert_array_equal(read(above), POINTS)


def test_the_plain_names_come_first_and_any_order_will_do() -> None:
    assert read("px,py,pz,z,y,x\n1,2,3,4,5,6\n").tolist() == [[6, 5, 4]]
    assert read("x_m,y_m,z_m,px,py,pz\n1,2,3,4,5,6\n").tolist() == [[1, 2, 3]]


def test_a_cell_may_hold_words_or_nothing_where_tabs_separate() -> None:
    assert read("name\tx\ty\tz\na b\t1\t2\t3\n\t4\t5\t6\n").tolist() == [[1, 2, 3], [4, 5, 6]]


@pytest.mark.parametrize(
    ("header", "separator", "comments"),
    [
        ("id,a,b,c", ",", ""),
        ("id a b c", " ", ""),
        ("id,a,b,c", ",", "# "),
        ("x,y,depth,id", ",", ""),
        ("id,nx,ny,nz", ",", ""),
        ("lon;lat;height;id", ";", ""),
    ],
)
def test_other_names_are_an_error(header: str, separator: str, comments: str) -> None:
    came = ", ".join(header.replace(separator, ",").split(","))
    message = f"expected columns x, y, z in the header, got {came}; name the three columns"
    with pytest.raises(ReadError, match=message):
        read(saved(header, separator, comments))


@pytest.mark.parametrize(
    "above",
    [
        "",
        "# a cloud of points\n",
        "# columns: x y z\n",
        "# x y z\n",
        "# Format: x, y, z, intensity\n",
        "a title\n",
        "Scan 3\n",
        "June 4 1996\n",
        "A title of five words\n",
        "// a comment, and another one\n",
        "% a comment\n%\n% x y z\n",
        "// a comment\n//\n//X Y Z\n",
    ],
)
def test_otherwise_the_first_three_columns_are_taken(above: str) -> None:
    np.testing.assert_array_equal(read(above + saved("", " ", "#")), NUMBERED[:, :3])
    assert read("a,b,c\n1,2,3\n").tolist() == [[1, 2, 3]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("# one\n\nx y z\n1 2 3\n4 5\n", "line 5: expected three numbers per line, .*, got 4 5;"),
        ("1 2 3\n \n4 five 6 # it\n", "line 3: .*, got 4 five 6; correct that line"),
        ("2\n1 2 3\n4 5 1_0\n", "line 3: .*, got 4 5 1_0;"),
        ("1,2,3\n1,,3\n", "line 2: .*, got 1,,3;"),
        ("id,x,y,z\n1,2,3\n", "line 2: .* in the columns 2, 3 and 4, .*, got 1,2,3;"),
        ("0,38;0,35;1\n", "line 1: .*, got 0,38;0,35;1; it has decimal commas, write"),
        ("x;y;z\n1;2;3\n1,5;2;3\n", "line 3: .*; it has decimal commas"),
        ("0,38 -0,35 1,2e-3\n", "line 1: .*; it has decimal commas"),
        ('"0,38","-0,35","1,2"\n', "line 1: .*; it has decimal commas"),
        ('"1","2","3"\n"1","","3"\n', 'line 2: .*, got "1","","3";'),
        (",2,3\n4,5,6\n", "line 1: .*, got ,2,3;"),
        ("1,2 # 3,4\n", "line 1: .*, got 1,2 # 3,4;"),
        ("X Y Z\n2\n3\n1 2 3\n", "line 3: .*, got 3;"),
        ("1.O 2.5 3.5\n4 5 6\n", "line 1: .*, got 1.O 2.5 3.5; correct that line"),
        ("# x y z i\n2\nnull,2,3,4\n4,5,6,7\n", "line 3: .*, got null,2,3,4;"),
        ("x y z\n? 2 3\n4 5 6\n", "line 2: .*, got . 2 3;"),
        ("part1 1 2 3\npart2 4 5 6\n", "line 1: .*, got part1 1 2 3;"),
    ],
)
def test_the_line_that_cannot_be_read_is_named(text: str, message: str) -> None:
    with pytest.raises(ReadError, match=f"a.txt, {message}") as caught:
        read(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["1,-2,3.5", "1 -2 3.5", " 1, -2,\t3.5 ", "1e0 -2 +3.5"])
def test_commas_and_spaces_separate(text: str) -> None:
    assert three_numbers(text) == (1.0, -2.0, 3.5)


@pytest.mark.parametrize("text", ["", "-", "1,2", "1 2 3 4", "1,2,x", "1,2,nan", "1,2,inf", "1;2"])
def test_anything_else_is_none(text: str) -> None:
    assert three_numbers(text) is None


def test_numbers_of_columns_above_decimals_are_a_header() -> None:
    found = read_text(("0,1,2\n" + "0.5,1,2\n" * 3).encode(), "a.csv")
    np.testing.assert_array_equal(found.points, [[0.5, 1, 2]] * 3)
    assert "numbers the columns" in found.notes[0]
    whole = read("0,1,2\n3,4,5\n")
    np.testing.assert_array_equal(whole, [[0, 1, 2], [3, 4, 5]])


@pytest.mark.parametrize("quote", ['"', "'"])
@pytest.mark.parametrize("separator", [",", ", ", ";", "\t", " "])
@pytest.mark.parametrize("header", ["", "x y z\n"])
def test_words_may_be_quoted(header: str, separator: str, quote: str) -> None:
    words = [quote + f"{value:.17g}" + quote for value in POINTS.ravel()]
    text = "".join(separator.join(words[i : i + 3]) + "\n" for i in range(0, 21, 3))
    np.testing.assert_array_equal(read(header.replace(" ", separator) + text), POINTS)


@pytest.mark.parametrize(
    "text",
    [
        "x,y,z,color\n1,2,3,#ff00aa\n4,5,6,#00ff00\n",
        "x,color,y,z\n1,#ff00aa,2,3\n4,#00ff00,5,6\n",
        "x\tcolor\ty\tz\n1\t#ff00aa\t2\t3\n4\t#00ff00\t5\t6\n",
        "label;x;y;z\npart #3;1;2;3\npart #4;4;5;6\n",
        "part #,x,y,z\n3,1,2,3\n4,4,5,6\n",
        "i,part #,x,y,z\n3,1,1,2,3\n4,2,4,5,6\n",
        '"name","x","y","z"\n"a, b","1","2","3"\n"c ""#1"", d","4","5","6"\n',
        '"name" "x" "y" "z"\n"a b" 1 2 3\n"c" 4 5 6\n',
        '"x" "y" "z"\n"1" 1 2 3\n"2" 4 5 6\n',
        "1,2,3 # one, two\n# 7,8,9\n4,5,6# the last\n",
    ],
)
def test_other_columns_may_hold_what_else_separates_or_comments(text: str) -> None:
    assert read(text).tolist() == [[1, 2, 3], [4, 5, 6]]


@pytest.mark.parametrize(
    "opening",
    [
        "//X Y Z\n2\n",
        "X,Y,Z\n2\n",
        "2\nx y z\n",
        "# a comment\n2\n",
        "2 # points\n",
        "2\n\t# a comment\n",
    ],
)
def test_a_header_and_a_count_may_both_come_first(opening: str) -> None:
    assert read(f"{opening}1 2 3\n4 5 6\n").tolist() == [[1, 2, 3], [4, 5, 6]]
    with pytest.raises(ReadError, match="announces 2 points, 1 came"):
        read(f"{opening}1 2 3\n")


def test_several_stations_in_one_file() -> None:
    text = "2\n1 2 3 0\n4 5 6 0\n0\n1 # one\n# of them\n7 8 9 0\n"
    assert read(text).tolist() == [[1, 2, 3], [4, 5, 6], [7, 8, 9]]
    with pytest.raises(ReadError, match="announces 5 points, 3 came"):
        read(text.replace("1 # one", "3"))
    with pytest.raises(ReadError, match=r"line 2: expected three numbers per line.*, got 1;"):
        read("3\n1\n4 5 6\n7 8 9\n")
    with pytest.raises(ReadError, match=r"line 2: .*, got 1;"):  # none was announced before
        read("1 2 3\n1\n4 5 6\n")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252", "latin-1"])
def test_other_encodings(encoding: str) -> None:
    text = "# Höhe über 0\nid,x [µm],y [µm],z [µm]\n7,1,2,3\n8,4,5,6\n"
    for ends in ("\n", "\r\n"):
        data = text.replace("\n", ends).encode(encoding)
        assert read_text(data, "a.csv").points.tolist() == [[1, 2, 3], [4, 5, 6]]
    wide = "\ufeff1 2 3\n".encode("utf-16-be")
    assert read_text(wide, "a.xyz").points.tolist() == [[1, 2, 3]]
    dots = "# more …\n1 2 3\n".encode("cp1252")  # which ends a line in latin-1
    assert read_text(dots, "a.xyz").points.tolist() == [[1, 2, 3]]


@pytest.mark.parametrize(
    "data",
    [b"\x02\xff 1 2 3\n", b"1 2 3\n\0", "1 2 3\n".encode("utf-16")[:-1], b"\xff\xd8\xff\xe0\0\x10"],
)
def test_binary_data_are_no_text(data: bytes) -> None:
    with pytest.raises(ReadError, match=r"a\.xyz: expected text, found binary data"):
        read_text(data, "a.xyz")
