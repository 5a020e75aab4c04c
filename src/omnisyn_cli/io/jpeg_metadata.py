"""The XMP packet of a JPEG, read and replaced without decoding the picture.

Source: ITU T.81, annex B (segments); Adobe, "XMP Specification Part 3", section 1.1.3 (APP1) and part 1 (packets).
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from xml.dom.minidom import Element, parseString
from xml.parsers.expat import ExpatError

from omnisyn_cli.errors import ImageError

XMP_HEADER = b"http://ns.adobe.com/xap/1.0/\0"  # with which the segment of the packet begins
GPANO = "http://ns.google.com/photos/1.0/panorama/"  # namespace of Google's tags: Google, "Photo Sphere XMP Metadata"
EXIF_HEADER = b"Exif\0\0"  # with which the segment of EXIF begins
RDF = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"  # namespace of RDF, which XMP is written in
XMLNS = "http://www.w3.org/2000/xmlns/"  # namespace of declarations of namespaces
# A packet without properties.
NEW_PACKET = (
    b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="' + RDF.encode() + b'">'
    b'<rdf:Description rdf:about=""/></rdf:RDF></x:xmpmeta>'
)
# The header of a packet; the id is the same in all, see part 1.
PACKET_BEGIN = b'<?xpacket begin="\xef\xbb\xbf" id="W5M0MpCehiHzreSzNTczkc9d"?>\n'
PACKET_END = b'<?xpacket end="w"?>'  # the trailer; the packet may be changed in place
START_OF_IMAGE, APP0, APP1, START_OF_SCAN = 0xD8, 0xE0, 0xE1, 0xDA  # second bytes of markers, after 0xFF
JPEG_MAGIC = bytes([0xFF, START_OF_IMAGE])  # the first bytes of every JPEG
MAX_SEGMENT_BYTES = 65533  # of the content of a segment: its length is a number of 16 bits and counts itself


def with_gpano(path: Path, data: bytes, values: Mapping[str, str]) -> bytes:
    """A JPEG of these bytes with some GPano tags in its XMP; everything else of it stays as it is, to the byte.

    Other properties of its packet stay too. A new packet takes the place of the old one, and its length if it fits.
    ImageError about ``path``: no JPEG, a damaged packet, or one that grows too large.
    """
    exif, packets = 2, []
    for marker, begin, end in _segments(path, data):
        content = data[begin + 4 : end]
        if marker == APP0 or (marker == APP1 and content.startswith(EXIF_HEADER)):
            exif = end
        if marker == APP1 and content.startswith(XMP_HEADER):
            packets.append((begin, end))
    first = packets[0] if packets else (exif, exif)
    old = data[first[0] + 4 + len(XMP_HEADER) : first[1]]
    xml = PACKET_BEGIN + _edited(path, old, values) + b"\n"
    blanks = b" " * max(len(old) - len(xml) - len(PACKET_END), 0)  # then nothing behind the packet moves
    content = XMP_HEADER + xml + blanks + PACKET_END
    if len(content) > MAX_SEGMENT_BYTES:
        raise ImageError(
            f"{path}: expected XMP of at most {MAX_SEGMENT_BYTES:,} bytes, got {len(content):,}; remove other tags"
        )
    segment = bytes([0xFF, APP1]) + (len(content) + 2).to_bytes(2, "big") + content
    return data[: first[0]] + segment + data[first[1] :]


def xmp_packet(path: Path, data: bytes) -> bytes:
    """The first packet of a JPEG that begins with these bytes; nothing where there is none, or the file is damaged."""
    try:
        packets = (data[begin + 4 : end] for marker, begin, end in _segments(path, data) if marker == APP1)
        return next((each[len(XMP_HEADER) :] for each in packets if each.startswith(XMP_HEADER)), b"")
    except ImageError:
        return b""


def _segments(path: Path, data: bytes) -> Iterator[tuple[int, int, int]]:
    """Marker, begin and end of every segment before the picture's own data."""
    if data[:2] != JPEG_MAGIC:
        raise ImageError(f"{path}: expected a JPEG, got another format; convert it, or leave it out")
    begin = 2
    while begin + 4 <= len(data) and data[begin] == 0xFF:
        if data[begin + 1] == 0xFF:  # markers may be filled up
            begin += 1
            continue
        if data[begin + 1] == START_OF_SCAN:
            return
        end = begin + 2 + int.from_bytes(data[begin + 2 : begin + 4], "big")
        yield data[begin + 1], begin, end
        begin = end
    raise ImageError(f"{path}: expected a JPEG, got a file without a picture; replace it")


def _edited(path: Path, packet: bytes, values: Mapping[str, str]) -> bytes:
    root = _parsed(path, packet or NEW_PACKET)
    found = ((node, node.parentNode) for node in root.getElementsByTagNameNS(RDF, "Description"))
    # of the picture, not of a part of a structure
    descriptions = [node for node, above in found if above and (above.namespaceURI, above.localName) == (RDF, "RDF")]
    if not descriptions:
        return _edited(path, NEW_PACKET, values)
    for description in descriptions:
        for name in values:
            if description.hasAttributeNS(GPANO, name):
                description.removeAttributeNS(GPANO, name)
        for old in [node for node in description.childNodes if node.namespaceURI == GPANO]:
            if old.localName in values:
                description.removeChild(old)
    descriptions[0].setAttributeNS(XMLNS, "xmlns:GPano", GPANO)
    for name, value in values.items():
        descriptions[0].setAttributeNS(GPANO, f"GPano:{name}", value)
    return root.toxml("utf-8")


def _parsed(path: Path, packet: bytes) -> Element:
    """The element of a packet; one that declares entities is refused, as they may be hostile."""
    text = packet.strip(b"\0 \n")
    try:
        if b"<!" in text.replace(b"<!--", b"").replace(b"<![CDATA[", b""):
            raise ValueError("a declaration of entities")
        root = parseString(text).documentElement  # noqa: S318 - there are no entities in it
    except (ExpatError, ValueError) as error:
        raise ImageError(f"{path}: expected readable XMP, got '{error}'; remove the tags and try again") from error
    if root is None:
        raise ImageError(f"{path}: expected readable XMP, got none; remove the tags and try again")
    return root
