"""Pages of a PDF that was drawn as one tall page."""

import re


def split_into_pages(pdf: bytes, height: int) -> bytes:
    """Return a PDF with one tall page as one with pages of a height [points], the top one first.

    Each page shows its part of the same drawing. The new objects follow the old ones as an
    incremental update (ISO 32000-1, 7.5.6).
    """
    page = re.search(rb"(\d+) 0 obj\s(<<\s*/Type /Page\b.*?)endobj", pdf, re.DOTALL)
    tree = re.search(rb"(\d+) 0 obj\s<<\s*/Type /Pages\b", pdf)
    root = re.search(rb"/Root (\d+) 0 R", pdf)
    sizes, starts = re.findall(rb"/Size (\d+)", pdf), re.findall(rb"startxref\s+(\d+)", pdf)
    box = re.search(rb"/MediaBox \[0 0 (\d+) (\d+)\]", pdf)
    assert page and tree and root and box, "as vl-convert writes them"
    size, count = int(sizes[-1]), round(int(box[2]) / height)
    numbers = [int(page[1]), *range(size, size + count - 1)]
    kids = b" ".join(b"%d 0 R" % number for number in numbers)
    objects = {int(tree[1]): b"<< /Type /Pages /Count %d /Kids [%b] >>\n" % (count, kids)}
    for i, number in enumerate(numbers):
        low = height * (count - 1 - i)
        of_page = b"/MediaBox [0 %d %b %d]" % (low, box[1], low + height)
        objects[number] = page[2].replace(box[0], of_page)
    parts, sections, at = [pdf.rstrip(b"\n") + b"\n"], [], len(pdf.rstrip(b"\n")) + 1
    for number, body in objects.items():
        parts.append(b"%d 0 obj\n%bendobj\n" % (number, body))
        sections.append(b"%d 1\n%010d 00000 n\r\n" % (number, at))
        at += len(parts[-1])
    trailer = b"trailer\n<< /Size %d /Root %b 0 R /Prev %b >>\nstartxref\n%d\n%%%%EOF\n"
    end = trailer % (size + count - 1, root[1], starts[-1], at)
    return b"".join([*parts, b"xref\n", *sections, end])
