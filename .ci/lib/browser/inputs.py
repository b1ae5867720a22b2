"""What the viewer looks at: small files, each written as its format says, of which every value is known."""
import json
import math
import struct
import subprocess

from browser.people import PROGRAM


def sheet_height(column, row):
    return 10 * math.sin(column / 30) * math.cos(row / 40)


def sheet(path):
    """A wavy sheet of points one unit apart, whose warmth is the number of their column."""
    with path.open("wb") as file:
        file.write(b"ply\nformat binary_little_endian 1.0\nelement vertex 40401\nproperty double x\nproperty double y\n"
                   b"property double z\nproperty float warmth\nend_header\n")
        for column in range(201):
            for row in range(201):
                file.write(struct.pack("<dddf", column - 100, row - 100, sheet_height(column, row), column))


def field_height(x, y):
    return 100 + 3 * math.sin(x / 9) + y / 20


def field(path):
    """A field of 120 by 80 metres, at centimetres, of two classes with a tower in its north-east."""
    points = [(x, y, field_height(x, y), 2) for x in range(120) for y in range(80)]
    points += [(100 + x / 4, 60 + y / 4, field_height(100, 60) + z / 2, 6) for x in range(20) for y in range(20) for z in range(40)]
    las(path, points, 0.01)


# Metres between points of which far more is known than their files say.
FINE = 0.03


def fine_point(column, row):
    return FINE * column, FINE * row, 100 + math.sin(column / 17) * math.cos(row / 13) / 2


def fine_points():
    return [fine_point(column, row) for column in range(160) for row in range(120)]


def centimetres(path):
    las(path, [(*point, 2) for point in fine_points()], 0.01)


def millimetres(path):
    las(path, [(*point, 2) for point in fine_points()], 0.001)


def text_of_centimetres(path):
    path.write_text("".join(f"{400_000 + x:.2f} {5_700_000 + y:.2f} {z:.2f}\n" for x, y, z in fine_points()))


def las(path, points, scale):
    """Points in metres from a place in UTM 33N, each with its class."""
    keys = struct.pack("<16H", 1, 1, 0, 3, 1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, 32633)
    record = struct.pack("<H16sHH32s", 0, b"LASF_Projection", 34735, len(keys), b"") + keys
    offset, east, north = 227 + len(record), 400_000, 5_700_000
    rows = [(round(x / scale), round(y / scale), round(z / scale), kind) for x, y, z, kind in points]
    ends = [(max(row[axis] for row in rows), min(row[axis] for row in rows)) for axis in range(3)]
    origin = (east, north, 0)
    with path.open("wb") as file:
        file.write(struct.pack("<4sHHIHH8sBB32s32sHHHIIBHI5I", b"LASF", 0, 0, 0, 0, 0, b"", 1, 2, b"", b"", 1, 2026, 227, offset, 1, 0, 20,
                               len(rows), len(rows), 0, 0, 0, 0))
        file.write(struct.pack("<6d", scale, scale, scale, *origin))
        for axis, (most, least) in enumerate(ends):
            file.write(struct.pack("<2d", most * scale + origin[axis], least * scale + origin[axis]))
        file.write(record)
        for x, y, z, kind in rows:
            file.write(struct.pack("<iiiHBBbBH", x, y, z, 100 * kind, 0b1001, kind, 0, 0, 0))


def voxel(x, y, z):
    return 1000 if (x - 12) ** 2 + (y - 10) ** 2 + (z - 8) ** 2 < 30 else 10 * x + y


def nrrd(path):
    """A ball of 1000 in a slope of lesser values."""
    sizes = (24, 20, 16)
    head = f"NRRD0004\ntype: short\ndimension: 3\nsizes: {' '.join(map(str, sizes))}\nencoding: raw\nendian: little\nspacings: 1 1 1\n\n"
    values = [voxel(x, y, z) for z in range(sizes[2]) for y in range(sizes[1]) for x in range(sizes[0])]
    path.write_bytes(head.encode() + struct.pack(f"<{len(values)}h", *values))


def body(path):
    """A computed tomography in Hounsfield units: tissue with a bone in air."""
    sizes = (40, 32, 24)

    def unit(x, y, z):
        away = math.dist((x, y, z), (20, 16, 12))
        return 1200 - 20 * z if away < 4 else 40 + x if away < 10 else -1000

    head = f"NRRD0004\ntype: short\ndimension: 3\nsizes: {' '.join(map(str, sizes))}\nencoding: raw\nendian: little\nspacings: 1 1 1\n\n"
    values = [unit(x, y, z) for z in range(sizes[2]) for y in range(sizes[1]) for x in range(sizes[0])]
    path.write_bytes(head.encode() + struct.pack(f"<{len(values)}h", *values))


def segments(path):
    """Two organs, side by side, as 3D Slicer writes segments; the second has no name."""
    sizes = (32, 24, 20)
    head = (f"NRRD0004\ntype: unsigned char\ndimension: 3\nsizes: {' '.join(map(str, sizes))}\nencoding: raw\nspacings: 1 1 1\n"
            "Segment0_Name:=liver\nSegment0_LabelValue:=3\nSegment0_Color:=0.8 0.2 0\n\n")

    def label(x, y, z):
        return 0 if math.dist((x, y, z), (16, 12, 10)) > 9 else 3 if x < 16 else 200

    values = [label(x, y, z) for z in range(sizes[2]) for y in range(sizes[1]) for x in range(sizes[0])]
    path.write_bytes(head.encode() + bytes(values))


def splats(path):
    """A few Gaussian splats, longer than wide, with a column more than points keep by themselves."""
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3", "height"]
    rows = [(math.cos(i), math.sin(i), i / 400, 1, 0, -1, 2, -3, -5, -4, 1, 0, 0, 0, i) for i in range(400)]
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 400\n" + "".join(f"property float {name}\n" for name in names)
    path.write_bytes((head + "end_header\n").encode() + b"".join(struct.pack("<15f", *row) for row in rows))


def ball(path):
    """A solid ball of radius 1."""
    scene = {"rayset": 1, "camera": {"position": [0, -6, 2], "lookAt": [0, 0, 0], "up": [0, 0, 1], "fovy": 35},
             "root": {"type": "sphere", "radius": 1}}
    path.write_text(json.dumps(scene))


def make_inputs(folder):
    written = {"sheet.ply": sheet, "field.las": field, "ball.json": ball, "slope.nrrd": nrrd, "splats.ply": splats, "body.nrrd": body, "organs.seg.nrrd": segments,
               "centimetres.las": centimetres, "millimetres.las": millimetres, "centimetres.xyz": text_of_centimetres}
    for name, write in written.items():
        write(folder / name)
    subprocess.run([PROGRAM, "generate", "knot-200k", "-o", str(folder / "points.ply")], check=True, capture_output=True)
