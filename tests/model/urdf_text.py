"""Pieces of URDF text for the tests of this folder."""

BOX = '<visual><geometry><box size="0.2 0.3 0.4"/></geometry></visual>'
LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'


def link(name: str, content: str = BOX) -> str:
    return f'<link name="{name}">{content}</link>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", content: str = LIMIT) -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{content}</joint>'


def mimic(leader: str, multiplier: float = 1.0, offset: float = 0.0) -> str:
    return f'<mimic joint="{leader}" multiplier="{multiplier}" offset="{offset}"/>'


def chain(*contents: str, kinds: tuple[str, ...] = ()) -> str:
    """Links l0, l1, ... with a box each, joined by j1, j2, ... of these contents (and kinds: revolute)."""
    kinds = kinds or ("revolute",) * len(contents)
    links = [link(f"l{index}") for index in range(len(contents) + 1)]
    joints = [
        joint(f"j{index}", f"l{index - 1}", f"l{index}", kind, content)
        for index, (kind, content) in enumerate(zip(kinds, contents, strict=True), start=1)
    ]
    return "".join(links + joints)
