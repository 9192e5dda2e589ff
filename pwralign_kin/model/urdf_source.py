"""The text of a URDF: found, expanded where it is a xacro, and parsed without trust."""

from __future__ import annotations

import codecs
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pwralign_kin.exceptions import DependencyError, ModelError, UnknownNameError
from pwralign_kin.model.packages import PackageFolders, folders_in

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

DECLARED_WITHIN = 4096
"""Bytes at the start of a file in which its XML declaration is looked for."""


def read_source(path: Path, packages: PackageFolders, xacro_args: Mapping[str, str]) -> bytes:
    """Return the bytes of the URDF at `path`, after xacro with `xacro_args` where its suffix or its macros ask for it.

    Raises `ModelError`, and `DependencyError` for a xacro without the xacro extra.
    """
    if str(path).lstrip().startswith("<"):
        raise ModelError("URDF", "expected the path of a file, got the text of one: write it to a file first")
    if not path.exists():
        raise ModelError(path, "no such file")
    if not path.is_file():
        raise ModelError(path, "not a file")
    try:
        written = path.read_bytes()
    except OSError as error:
        raise ModelError(path, f"cannot read: {error.strerror}") from None
    if path.suffix == ".xacro" or b"<xacro:" in re.sub(rb"<!--.*?-->", b"", written, flags=re.DOTALL):
        return _expand_xacro(path, packages, xacro_args)
    if xacro_args:
        raise ModelError(path, "takes no xacro arguments: it holds no macros, and its name does not end in .xacro")
    return written


def _expand_xacro(path: Path, packages: PackageFolders, values: Mapping[str, str]) -> bytes:
    try:
        import xacro
        import xacrodoc
    except ImportError:
        remedy = 'pip install "pwralign-kin[xacro]"'
        raise DependencyError(f"{path.name} is a xacro, and xacrodoc is not installed", remedy) from None
    with _declared_arguments(values) as declared:
        try:
            xacrodoc.packages.reset()
            xacrodoc.packages.update_package_cache(_packages(path, packages))
            xacro.init_stacks(str(path.absolute()))  # relative includes start beside the file, not where we run
            urdf = str(xacrodoc.XacroDoc.from_file(str(path), subargs=dict(values)).to_urdf_string())
        except Exception as error:  # xacro evaluates the file's own expressions: anything may come out
            raise ModelError(path, _xacro_fault(" ".join(str(error).split()), declared, values)) from None
    missing = [name for name, has_default in declared.items() if not has_default and name not in values]
    if missing:
        raise ModelError(path, _missing_arguments(missing))
    unknown = [name for name in values if name not in declared]
    if unknown:
        raise UnknownNameError(f"xacro argument of {path.name}", unknown[0], declared)
    if "<link" not in urdf:
        raise ModelError(path, "makes no links: if it only defines macros, give the file that calls them")
    return urdf.encode()


@contextmanager
def _declared_arguments(values: Mapping[str, str]) -> Iterator[dict[str, bool]]:
    """Collect the names of <xacro:arg> while xacro runs, and whether each has a default.

    xacro itself refuses one without a default, even where it is given a value.
    """
    import xacro

    declared: dict[str, bool] = {}
    check = xacro.check_attrs

    def collect(element: Any, required: list[str], optional: list[str]) -> Any:
        if element.tagName == "xacro:arg":
            name = element.getAttribute("name")
            declared.setdefault(name, element.hasAttribute("default"))
            if not element.hasAttribute("default"):
                element.setAttribute("default", values.get(name, ""))
        return check(element, required, optional)

    xacro.check_attrs = collect
    try:
        yield declared
    finally:
        xacro.check_attrs = check


def _xacro_fault(reason: str, declared: Mapping[str, bool], values: Mapping[str, str]) -> str:
    """Return what is wrong, and what the user can do about it."""
    undefined = re.search(r"Undefined substitution argument (\S+)", reason)
    if undefined:
        others = [name for name, has_default in declared.items() if not has_default and name not in values]
        return _missing_arguments(dict.fromkeys([undefined[1], *others]))
    package = re.search(r"Package not found: (\S+)", reason)
    if package:
        return (
            f"xacro finds no package {package[1]!r}: name a folder that contains it with package_dirs / --package-dir"
        )
    return f"xacro fails: {reason}"


def _missing_arguments(names: Collection[str]) -> str:
    listed = ", ".join(map(repr, names))
    remedy = " ".join(f"--xacro-arg {name}=VALUE" for name in names)
    return f"the xacro needs a value of its argument {listed}: give it with xacro_args / {remedy}"


def _packages(path: Path, packages: PackageFolders) -> dict[str, Path]:
    """Return packages by name: those in `packages`, those beside the folders above the file, and those folders.

    Distributions of robots often leave out `package.xml`.
    """
    above = path.absolute().parents[:4]
    beside = [entry for folder in above for entry in folders_in(folder)]
    given = [entry for folder in packages for entry in (folder, *folders_in(folder))]
    return _by_name((*beside, *above), given) | packages.below | _by_name(*map(_marked, (beside, given)))


def _by_name(*several: Iterable[Path]) -> dict[str, Path]:
    return {folder.name: folder for folders in several for folder in folders}


def _marked(folders: Iterable[Path]) -> list[Path]:
    return [folder for folder in folders if (folder / "package.xml").is_file()]


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
            raise ModelError(path, f"not a URDF, for it is not XML: {error.msg}") from None
        root = etree.fromstring(source, parser(recover=True))
    if root.getroottree().docinfo.internalDTD is not None:
        raise ModelError(path, "declares a document type; none is read, remove it")
    if root.tag != "robot":
        raise ModelError(path, f"not a URDF: its root element is <{root.tag}>, not <robot>")
    return root
