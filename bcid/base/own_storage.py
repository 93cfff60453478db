"""HDF5 files of others hold their values themselves: what leads out of a file, or needs a plugin, is refused."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from bcid.base.errors import InputError
from bcid.base.unpacked import refuse_large

# Filters that HDF5 brings along (deflate, shuffle, Fletcher32, szip, n-bit, scale and offset), and LZF, which h5py does.
_FILTERS = frozenset({1, 2, 3, 4, 5, 6, 32000})
_DEEPEST = 64


def refuse_outside(file: Any) -> None:
    """Look at every link and dataset of an open HDF5 file; nothing is followed out of it, and no value is read.

    Args:
        file: an `h5py.File`.

    Raises:
        InputError: an external or user-defined link, external or virtual storage, too large a shape, a filter that is not built in,
            or groups nested too deeply.
    """
    from h5py import h5l

    for path, group, name in _links(file):
        kind = group.id.links.get_info(name).type
        if kind == h5l.TYPE_EXTERNAL:
            leads = group.id.links.get_val(name)[0].decode("utf-8", "replace")
            raise InputError(f"'{path}' is a link to the file '{leads[:80]}'; copy what it leads to")
        if kind not in (h5l.TYPE_HARD, h5l.TYPE_SOFT):
            raise InputError(f"'{path}' is a link of a kind that only a plugin can follow; copy what it leads to")
        if kind == h5l.TYPE_HARD:
            _refuse_storage(path, group, name)


def _refuse_storage(path: str, group: Any, name: bytes) -> None:
    from h5py import h5d, h5o

    if h5o.get_info(group.id, name).type != h5o.TYPE_DATASET:
        return
    dataset = h5d.open(group.id, name)
    created = dataset.get_create_plist()
    if created.get_layout() == h5d.VIRTUAL or created.get_external_count():
        raise InputError(f"the values of '{path}' are kept in another file, or by reference; repack the file")
    size = dataset.get_space().get_simple_extent_npoints() * dataset.get_type().get_size()
    refuse_large(size, f"'{path}' unpacks to", "keep only what is to be read")
    for number in range(created.get_nfilters()):
        if (code := created.get_filter(number)[0]) not in _FILTERS:
            raise InputError(f"the values of '{path}' pass the filter {code}, a plugin; repack the file with gzip")


def _links(file: Any) -> Iterator[tuple[str, Any, bytes]]:
    """Path, group and name of every link; each group once, for links may go in circles."""
    from h5py import Group, h5g, h5l, h5o

    seen, left = {h5o.get_info(file.id).addr}, [("", file)]
    while left:
        path, group = left.pop()
        if path.count("/") > _DEEPEST:
            raise InputError("its groups are nested too deeply")
        for name in list(group.id):
            below = f"{path}/{name.decode('utf-8', 'replace')}"
            yield below, group, name
            if group.id.links.get_info(name).type != h5l.TYPE_HARD:
                continue
            found = h5o.get_info(group.id, name)
            if found.type == h5o.TYPE_GROUP and found.addr not in seen:
                seen.add(found.addr)
                left.append((below, Group(h5g.open(group.id, name))))
