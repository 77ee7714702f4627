"""What the daemon has said to what a client sent: answers to who waits for them, and refusals, by the id of each.

Each answer brings its reasons: the warnings and errors of the request.

Bounded whatever the script does: answers that nobody waits for are not kept, and of refusals only the first ones are.
"""

from __future__ import annotations

from typing import Any

from slidectl.errors import AmbiguousName, MessageRefused, Refused, SlidectlError, UnknownName, Unused

Message = dict[str, Any]

_OPS = ("service_response", "status")
_MOST_REFUSALS = 1000
_WRONG_NAMES: dict[str, type[SlidectlError]] = {cause.__name__: cause for cause in (AmbiguousName, UnknownName, Unused)}


class Replies:
    """Answers and refusals that have arrived."""

    def __init__(self) -> None:
        self._awaited: set[str] = set()
        self._answers: dict[str, Message] = {}
        self._refusals: dict[str, SlidectlError] = {}
        self.reasons: list[str] = []
        """Those of the answer that was asked for last."""

    def expect(self, sent_id: str) -> None:
        """Somebody will ask for the answer."""
        self._awaited.add(sent_id)

    def forget(self, sent_id: str) -> None:
        """Nobody will."""
        self._awaited.discard(sent_id)
        self._answers.pop(sent_id, None)

    def has(self, sent_id: str) -> bool:
        """True when the answer is here."""
        return sent_id in self._answers

    def take_in(self, message: Message) -> None:
        """A `service_response` or a `status` has arrived; others are no replies."""
        op = message.get("op")
        if op == "status" and message.get("level") == "error" and len(self._refusals) < _MOST_REFUSALS:
            self._refusals[str(message.get("id"))] = _refusal(MessageRefused, str(message.get("msg", "")), message)
        if op in _OPS and message.get("id") in self._awaited:
            self._answers[message["id"]] = message

    def answer(self, sent_id: str) -> Message:
        """The values of an answer that is here; it is forgotten. Raises Refused with the text and exit code in it."""
        self._awaited.discard(sent_id)
        answer = self._answers.pop(sent_id)
        self.reasons = list(map(str, answer.get("reasons", ())))
        values = answer.get("values")
        if not answer.get("result", True):
            raise _refusal(Refused, str(values), answer)
        return values if isinstance(values, dict) else {}

    def resolved(self, sent_id: str) -> Message:
        """`answer` for a name that was to be resolved. Raises UnknownName, AmbiguousName, Unused; else Refused."""
        answer = self._answers[sent_id]
        cause = _WRONG_NAMES.get(str(answer.get("cause")))
        try:
            return self.answer(sent_id)
        except Refused as refusal:
            if cause is None:
                raise
            error = cause.__new__(cause)  # without the constructor, which makes the text that is here already
            message, _, hint = refusal.message.partition("\n")
            SlidectlError.__init__(error, message, hint or None)
            if isinstance(error, UnknownName):
                error.kind, error.name, error.known = "", "", []
            if isinstance(error, AmbiguousName):
                error.matches = list(map(str, answer.get("matches", ())))
            raise error from None

    def raise_refusal(self, sent_id: str | None = None) -> None:
        """Raise the refusal of what was sent with that id; without one the first of all, and forget the others."""
        refusal = self._refusals.pop(next(iter(self._refusals), "") if sent_id is None else sent_id, None)
        if sent_id is None:
            self._refusals.clear()
        if refusal is not None:
            raise refusal


def _refusal(cause: type[Refused], text: str, answer: Message) -> Refused:
    error = cause(text)
    error.exit_code = int(answer.get("exit_code", cause.exit_code))
    return error
