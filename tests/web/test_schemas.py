"""The page's types of the server's documents."""

from tests.web.write_schemas import TYPES, types


def test_types_are_those_of_the_server() -> None:
    assert TYPES.read_text() == types(), "run `make schemas`"
