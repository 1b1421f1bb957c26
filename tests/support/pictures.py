"""Writes TIFF and PNG files."""
import struct
import zlib

UINT, INT, FLOAT = 1, 2, 3     # the sample formats of TIFF
NONE, LZW, DEFLATE, OLD_DEFLATE, PACKBITS = 1, 5, 8, 32946, 32773   # compressions of TIFF


def lzw(data):
    """Compresses bytes as TIFF's LZW: codes of 9 to 12 bits, which grow one code early."""
    bits = [(256, 9)]
    table = {bytes([n]): n for n in range(256)}
    word = b""
    code = 258
    width = 9
    for byte in data:
        longer = word + bytes([byte])
        if longer in table:
            word = longer
            continue
        bits.append((table[word], width))
        table[longer] = code
        code += 1
        width = 9 + (code > 510) + (code > 1022) + (code > 2046)
        word = bytes([byte])
        if code == 4094:
            bits.append((256, width))
            table = {bytes([n]): n for n in range(256)}
            code, width = 258, 9
    bits += [(table[word], width), (257, width)]
    text = "".join(f"{number:0{width}b}" for number, width in bits)
    text += "0" * (-len(text) % 8)
    return int(text, 2).to_bytes(len(text) // 8, "big")


def packbits(data):
    """Compresses bytes as PackBits: runs of up to 128 equal bytes, and single bytes."""
    out = b""
    at = 0
    while at < len(data):
        run = 1
        while run < 128 and data[at:at + 1] == data[at + run:at + run + 1]:
            run += 1
        out += struct.pack("b", 1 - run) + data[at:at + 1]
        at += run
    return out


PACK = {NONE: bytes, LZW: lzw, DEFLATE: zlib.compress, OLD_DEFLATE: zlib.compress, PACKBITS: packbits}


def differences(row, width):
    """Applies TIFF's horizontal predictor to a little-endian row."""
    numbers = [int.from_bytes(row[n:n + width], "little") for n in range(0, len(row), width)]
    return b"".join(((b - a) % 256 ** width).to_bytes(width, "little") for a, b in zip([0, *numbers], numbers))


class Tiff:
    """Writes a TIFF, page by page. Rows are bytes in the order `order`, from the top. strip: rows of a strip. Tags
    replace those that the page would have: _270="text"; None leaves a tag out."""
    def __init__(self, order="<", big=False, bits=8, kind=UINT, packing=NONE, strip=2, **tags):
        self.order, self.big, self.bits, self.kind, self.packing, self.strip = order, big, bits, kind, packing, strip
        self.tags = {int(tag[1:]): given for tag, given in tags.items()}
        self.out = bytearray((b"II" if order == "<" else b"MM") + struct.pack(order + "H", 43 if big else 42))
        self.out += struct.pack(order + "HHQ", 8, 0, 0) if big else struct.pack(order + "I", 0)
        self.link = len(self.out) - (8 if big else 4)

    def entry(self, tag, given):
        kind, letter = (4, "I")
        if isinstance(given, (str, bytes)):
            data = (given.encode() if isinstance(given, str) else given) + b"\0"
            kind, count = 2, len(data)
        elif isinstance(given[0], tuple):
            kind, count = 5, len(given)
            data = b"".join(struct.pack(self.order + "II", *one) for one in given)
        else:
            if tag in (258, 259, 262, 274, 277, 284, 296, 317, 320, 338, 339):
                kind, letter = 3, "H"
            elif self.big and tag in (273, 279, 324, 325):
                kind, letter = 16, "Q"
            data, count = struct.pack(self.order + f"{len(given)}{letter}", *given), len(given)
        size = 8 if self.big else 4
        if len(data) > size:
            at = self.add(data)
            data = struct.pack(self.order + ("Q" if self.big else "I"), at)
        return struct.pack(self.order + ("HHQ" if self.big else "HHI"), tag, kind, count) + data.ljust(size, b"\0")

    def add(self, data):
        self.out += bytes(len(self.out) % 2)
        at = len(self.out)
        self.out += data
        return at

    def directory(self, tags):
        entries = [self.entry(tag, tags[tag]) for tag in sorted(tags)]
        at = self.add(struct.pack(self.order + ("Q" if self.big else "H"), len(entries)) + b"".join(entries))
        place = self.order + ("Q" if self.big else "I")
        struct.pack_into(place, self.out, self.link, at)
        self.link = len(self.out)
        self.out += bytes(8 if self.big else 4)

    def basic(self, width, height):
        return {256: [width], 257: [height], 258: [self.bits], 259: [self.packing], 262: [1], 277: [1],
                339: [self.kind]}

    def page(self, rows, width):
        if self.tags.get(317) == [2]:
            rows = [differences(row, self.bits // 8) for row in rows]
        strips = [PACK[self.packing](b"".join(rows[n:n + self.strip])) for n in range(0, len(rows), self.strip)]
        tags = {**self.basic(width, len(rows)), 273: [self.add(strip) for strip in strips], 278: [self.strip],
                279: [len(strip) for strip in strips], **self.tags}
        self.directory({tag: given for tag, given in tags.items() if given is not None})
        return self

    def tiles(self, rows, width, side=16):
        """Adds a page of square tiles of `side` pixels."""
        each = len(rows[0]) // width
        wide = [row.ljust(-(-width // side) * side * each, b"\0") for row in rows]
        wide += [bytes(len(wide[0]))] * (-len(rows) % side)
        tiles = [PACK[self.packing](b"".join(row[left:left + side * each] for row in wide[top:top + side]))
                 for top in range(0, len(wide), side) for left in range(0, len(wide[0]), side * each)]
        self.directory({**self.basic(width, len(rows)), 322: [side], 323: [side],
                        324: [self.add(tile) for tile in tiles], 325: [len(tile) for tile in tiles], **self.tags})
        return self

    def bytes(self):
        return bytes(self.out)


def png(rows, width, bits=8, colour=0, interlaced=False, extra=b""):
    """Returns a PNG of rows of bytes, from the top. Numbers of 16 bits are big-endian. extra: more chunks."""
    def chunk(name, data):
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    passes = [rows]
    if interlaced:   # Adam7, for 8 bits
        passes = [[row[x::dx] for row in rows[y::dy] if row[x::dx]] for x, y, dx, dy in
                  ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))]
    lines = b"".join(b"\0" + row for one in passes for row in one)
    header = struct.pack(">IIBBBBB", width, len(rows), bits, colour, 0, 0, interlaced)
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + extra + chunk(b"IDAT", zlib.compress(lines))
            + chunk(b"IEND", b""))


def palette():
    """Returns a chunk of 256 black colours."""
    return struct.pack(">I", 768) + b"PLTE" + bytes(768) + struct.pack(">I", zlib.crc32(b"PLTE" + bytes(768)))
