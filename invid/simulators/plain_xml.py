"""XML read as it stands: prefixes and comments kept, and nothing from outside the text."""

from __future__ import annotations

from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from invid.errors import InputError


def parsed(text: bytes, source: str) -> Element:
    """The root; InputError names line and column. A DOCTYPE, which could name other files, is refused."""
    builder = TreeBuilder(insert_comments=True)
    parser = expat.ParserCreate()  # no namespaces: a prefix stays what the user wrote
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    parser.CharacterDataHandler, parser.CommentHandler = builder.data, builder.comment

    def refuse(name: str, *_: object) -> None:
        raise InputError(f"{source}: has a DOCTYPE ({name}), which is not read; delete that line")

    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise InputError(f"{source}: is no XML: {error}") from None
    return builder.close()
