"""What the answer of a peer means for an instance: stored, to be tried again, or refused for good. With advice."""

from __future__ import annotations

from worker.records.delivery_tables import Outcome as Outcome

_WARNINGS = {
    0xB000: "the peer changed some elements (coercion of data elements)",
    0xB006: "the peer discarded some elements",
    0xB007: "the peer says that the data set does not match its SOP class, and stored it",
}

_REFUSALS = {
    0x0105: ("no such attribute", "the peer does not know an attribute of the object"),
    0x0106: ("invalid attribute value", "the peer does not accept the value of an attribute; its log says which"),
    0x0110: ("processing failure", "see the peer's log"),
    0x0112: ("no such SOP instance", "see the peer's log"),
    0x0117: ("invalid SOP instance", "the peer does not accept the instance UID; see its log"),
    0x0118: ("no such SOP class", "the peer accepted the class when it was negotiated; see its log"),
    0x0122: ("SOP class not supported", "enable this SOP class in the peer, or leave this series out"),
    0x0124: ("not authorised", "give the calling AE title the right to store in the peer"),
    0x0210: ("duplicate invocation", "see the peer's log"),
    0x0211: ("unrecognised operation", "the peer does not store: is this the AE title of its storage service?"),
    0x0212: ("mistyped argument", "see the peer's log"),
}


def of_status(status: int) -> Outcome:
    """The meaning of the status of a C-STORE response."""
    if status == 0x0000:
        return Outcome("stored", "stored", status=status)
    if status == 0x0111:
        return Outcome("stored", "duplicate", "the peer had this instance already (0x0111)", status)
    if status & 0xF000 == 0xB000:
        text = _WARNINGS.get(status, "the peer stored it with a warning")
        return Outcome("stored", "stored-with-warning", f"{text} (0x{status:04X})", status)
    if status & 0xFF00 == 0xA700:
        text = f"the peer is out of resources (0x{status:04X}), most often of disk space: free some there"
        return Outcome("again", "out-of-resources", text, status)
    if status & 0xFF00 == 0xA900:
        text = f"the peer says that the data set does not match its SOP class (0x{status:04X}): see the peer's log"
        return Outcome("refused", "data-set-refused", text, status)
    if status & 0xF000 == 0xC000:
        text = f"the peer cannot understand the object (0x{status:04X}): see the peer's log for the reason"
        return Outcome("refused", "not-understood", text, status)
    name, advice = _REFUSALS.get(status, ("unknown status", "see the peer's log"))
    return Outcome("refused", "refused", f"the peer refused the instance: {name} (0x{status:04X}); {advice}", status)


def no_answer(reason: str, called_aet: str, calling_aet: str) -> Outcome:
    """The association ended without a response."""
    text = (
        f"{reason}. Some archives end the association like this where they do not know who calls: check that "
        f"{called_aet} allows {calling_aet} to store; else see the peer's log"
    )
    return Outcome("again", "no-answer", text)


def stalled(seconds: float) -> Outcome:
    """The peer stopped reading."""
    text = f"the peer took no byte for {seconds:g} s: see whether it hangs or its disk is slow, or raise stall_seconds"
    return Outcome("again", "stalled", text)


def class_refused(name: str, called_aet: str) -> Outcome:
    """The peer takes no object of this class."""
    text = f"{called_aet} does not accept {name}: enable this SOP class there, or leave this series out"
    return Outcome("refused", "class-refused", text)


def syntax_refused(name: str, offered: str, called_aet: str) -> Outcome:
    """The peer takes the class in none of the transfer syntaxes that can be sent."""
    text = f"{called_aet} accepts {name} in none of the transfer syntaxes {offered}: enable one of them there"
    return Outcome("refused", "transfer-syntax-refused", text)


def unreadable(name: str, reason: str) -> Outcome:
    """The file cannot be read, is no DICOM or cannot be decompressed."""
    return Outcome("refused", "file-not-readable", f"{name}: {reason}; run the case again to make it anew")


def reused(uid: str) -> Outcome:
    """An archive keeps the old version silently where a known UID arrives with new content."""
    text = (
        f"the destination has another version of {uid} already: it would keep the old one and say that it stored the "
        "new one. Remove the old one there, and forget the delivery that sent it"
    )
    return Outcome("refused", "uid-reused", text)
