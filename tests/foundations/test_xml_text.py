"""Attributes of XML that we write, read back by another reader."""

from xml.etree import ElementTree

import pytest

from calib.foundations.xml_text import quoted


@pytest.mark.parametrize("text", ["joint_1", "a b", "<&>", "'\"'", 'a"b', "tab\tline\nreturn\r", "ä关"])
def test_attributes_are_read_as_they_were_meant(text: str) -> None:
    assert ElementTree.fromstring(f"<a b={quoted(text)}/>").get("b") == text  # noqa: S314 - our own
