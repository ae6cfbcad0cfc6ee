# SPDX-License-Identifier: GPL-3.0-or-later
"""Messages and errors as they go to another process and are translated there."""

import copy
import pickle

import pytest
from dynamic_morph_targets.core import errors
from dynamic_morph_targets.core.message import Message, joined, listed, named_frames, translated

NAME = "Arm {left} {0} {"
GERMAN = {"'{name}' has no {what}": "'{name}' fehlt: {what}", "bake": "Bake", "frame {number}": "Bild {number}"}


def every_error():
    def below(kind):
        for each in kind.__subclasses__():
            yield each
            yield from below(each)

    return [errors.DynamorphError, *below(errors.DynamorphError)]


def sent(what):
    for protocol in range(2, pickle.HIGHEST_PROTOCOL + 1):
        yield pickle.loads(pickle.dumps(what, protocol))
    yield copy.copy(what)
    yield copy.deepcopy(what)


@pytest.mark.parametrize(
    "message",
    [
        Message("'{name}' has no {what}", name=NAME, what=Message("bake")),
        Message("plain"),
        joined(" ", [Message("'{name}' has no {what}", name=NAME, what="bake"), "{as it is}"]),
        listed([NAME] * 7),
        named_frames(3, 3),
    ],
)
def test_a_message_arrives_as_it_was_sent(message):
    german = translated(message, lambda text: GERMAN.get(text, text))
    for again in sent(message):
        assert type(again) is Message and again == message
        assert (again.template, again.values) == (message.template, message.values)
        assert translated(again, lambda text: GERMAN.get(text, text)) == german


@pytest.mark.parametrize("kind", every_error())
def test_an_error_arrives_as_it_was_raised(kind):
    for error in (kind("'{name}' has no bake", name=NAME), kind("no {braces}"), kind()):
        for again in sent(error):
            assert type(again) is kind
            assert errors.sentence(again) == errors.sentence(error) if error.args else again.args == ()
