"""The text of a URDF: found, expanded from xacro where the suffix says so, and parsed without trust."""

from __future__ import annotations

import codecs
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pwralign_kin.exceptions import DependencyError, ModelError

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

DECLARED_WITHIN = 4096
"""Bytes at the start of a file in which its XML declaration is looked for."""


def read_source(path: Path, package_dirs: Sequence[Path]) -> bytes:
    """Return the bytes of the URDF at `path`, after xacro where the suffix says so.

    Raises `ModelError`, and `DependencyError` for a xacro without the xacro extra.
    """
    if not path.exists():
        raise ModelError(path, "no such file")
    if not path.is_file():
        raise ModelError(path, "not a file")
    if path.suffix == ".xacro":
        return _expand_xacro(path, package_dirs)
    try:
        return path.read_bytes()
    except OSError as error:
        raise ModelError(path, f"cannot read: {error.strerror}") from None


def _expand_xacro(path: Path, package_dirs: Sequence[Path]) -> bytes:
    try:
        import xacrodoc
    except ImportError:
        remedy = 'pip install "pwralign-kin[xacro]"'
        raise DependencyError(f"{path.name} is a xacro, and xacrodoc is not installed", remedy) from None
    try:
        xacrodoc.packages.reset()
        xacrodoc.packages.update_package_cache(_packages(path, package_dirs))
        return str(xacrodoc.XacroDoc.from_file(str(path)).to_urdf_string()).encode()
    except Exception as error:  # xacro evaluates the file's own expressions: anything may come out
        raise ModelError(path, f"xacro fails: {' '.join(str(error).split())}") from None


def _packages(path: Path, package_dirs: Sequence[Path]) -> dict[str, Path]:
    """Return packages by name: those in `package_dirs`, those beside the folders above the file, and those folders.

    Distributions of robots often leave out `package.xml`.
    """
    above = path.absolute().parents[:4]
    beside = [entry for folder in above for entry in _folders(folder)]
    marked = {entry.name: entry for entry in beside if (entry / "package.xml").is_file()}
    given = {entry.name: entry for folder in package_dirs for entry in (folder, *_folders(folder))}
    return {entry.name: entry for entry in (*beside, *above)} | marked | given


def _folders(folder: Path) -> list[Path]:
    try:
        return sorted(entry for entry in folder.iterdir() if entry.is_dir())
    except OSError:
        return []


def well_declared(source: bytes) -> bytes:
    """Return the source with its XML declaration, where it has one, at the start and of version 1.0."""
    declaration = re.search(rb"<\?xml\s([^>]*)\?>", source[:DECLARED_WITHIN])
    if declaration is None:
        return source
    before = source[: declaration.start()].removeprefix(codecs.BOM_UTF8)
    if not before and re.search(rb"version\s*=\s*[\"']1\.\d[\"']", declaration[1]):
        return source
    encoding = re.search(rb"encoding\s*=\s*[\"']([\w.-]+)[\"']", declaration[1])
    start = b'<?xml version="1.0" encoding="%s"?>' % (encoding[1] if encoding else b"utf-8")
    return start + before.lstrip() + source[declaration.end() :]


def parse_xml(source: bytes, path: Path) -> Element:
    """Return the root element; nothing outside the file is read, no entity expanded. Raises `ModelError`."""
    from lxml import etree

    def parser(recover: bool) -> etree.XMLParser:
        return etree.XMLParser(
            resolve_entities=False, no_network=True, remove_comments=True, remove_pis=True, recover=recover
        )

    strict = parser(recover=False)
    try:
        root = etree.fromstring(source, strict)
    except etree.XMLSyntaxError as error:
        # Old URDFs hold simulator tags with undeclared prefixes: those alone are forgiven.
        if any(entry.domain_name != "NAMESPACE" for entry in strict.error_log):
            raise ModelError(path, f"not XML: {error}") from None
        root = etree.fromstring(source, parser(recover=True))
    if root.getroottree().docinfo.internalDTD is not None:
        raise ModelError(path, "declares a document type; none is read, remove it")
    if root.tag != "robot":
        raise ModelError(path, f"not a URDF: its root element is <{root.tag}>, not <robot>")
    return root
