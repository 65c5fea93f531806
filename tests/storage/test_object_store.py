"""What object stores say, as a person reads it."""

import pytest

from isogi_core.storage.object_store import sentence


@pytest.mark.parametrize(
    ("said", "told"),
    [
        ("Error performing GET http://a/b?key=1 in 2s - HTTP error: error sending request", "before an answer"),
        ("Generic S3 error: HTTP error: request or response body error\n\nDebug source:", "in the middle of an answer"),
        ("Error performing PUT http://a/b in 1s - HTTP error: operation timed out", "no answer came in time"),
        (
            'Error performing PUT http://a/b in 1s - Server returned non-2xx status code: 400 Bad Request: {"a":{}}',
            "status code: 400 Bad Request",
        ),
        (
            "Error in 1s - Server returned non-2xx status code: 403 Forbidden: <Error><Code>",
            "status code: 403 Forbidden",
        ),
    ],
)
def test_what_a_bucket_says_is_a_sentence(said: str, told: str) -> None:
    words = sentence(OSError(said))
    assert words.endswith(told)
    assert not {"{", "<", "/", "?", "\n"} & {*words}
