#!/usr/bin/env python3
"""Compares the rendering of grids with VTK's CPU ray caster, in alternating runs.

    pip install vtk
    rayset bench --scenes grid --dir FOLDER
    benches/peers/vtk_grids.py target/release/rayset FOLDER [--runs 5]

FOLDER holds the grids and scenes that `rayset bench --scenes` writes: grid-64 and grid-512, unlit and lit. VTK gets the
same voxels, camera, transfer functions, size (512 x 512) and distance between samples (0.9 voxels): vtkFixedPointVolumeRayCastMapper
with one thread, automatic sample distances off and an image sample distance of 1, trilinear interpolation. Both sides
are measured without reading the file: rayset's time is that of the picture as `render --stats` reports it, VTK's the
median of renders after the first.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import time

SIDES = (64, 512)
LOOKS = ("unlit", "lit")


def transfer(vtk, scene, side):
    """The scene's transfer function, in VTK's terms."""
    function = scene["root"]["transferFunction"]
    opacity = vtk.vtkPiecewiseFunction()
    for value, o in function["opacity"]:
        opacity.AddPoint(value, o)
    color = vtk.vtkColorTransferFunction()
    low, high = function["valueRange"]
    for place, text in function["color"]:
        rgb = [int(text[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in rgb]
        color.AddRGBPoint(low + place * (high - low), *linear)
    prop = vtk.vtkVolumeProperty()
    prop.SetScalarOpacity(opacity)
    prop.SetColor(color)
    prop.SetInterpolationTypeToLinear()
    prop.SetScalarOpacityUnitDistance(scene["rendering"]["unitDistance"])
    return prop


def window(vtk, folder, side, look):
    """A window with the scene of `folder`/grid-SIDE-LOOK.json."""
    with open(os.path.join(folder, f"grid-{side}-{look}.json")) as file:
        scene = json.load(file)
    reader = vtk.vtkImageReader2()
    reader.SetFileName(os.path.join(folder, f"grid-{side}.raw"))
    reader.SetFileDimensionality(3)
    reader.SetDataExtent(0, side - 1, 0, side - 1, 0, side - 1)
    reader.SetDataScalarTypeToUnsignedChar()
    reader.SetNumberOfScalarComponents(1)
    reader.SetDataSpacing(*[1.0 / (side - 1)] * 3)
    reader.FileLowerLeftOn()
    reader.Update()
    mapper = vtk.vtkFixedPointVolumeRayCastMapper()
    mapper.SetInputConnection(reader.GetOutputPort())
    mapper.SetNumberOfThreads(1)
    mapper.AutoAdjustSampleDistancesOff()
    mapper.SetImageSampleDistance(1.0)
    mapper.SetSampleDistance(scene["rendering"]["step"])
    prop = transfer(vtk, scene, side)
    if look == "lit":
        prop.ShadeOn()
        prop.SetAmbient(0.3)
        prop.SetDiffuse(0.7)
        prop.SetSpecular(0.0)
    volume = vtk.vtkVolume()
    volume.SetMapper(mapper)
    volume.SetProperty(prop)
    renderer = vtk.vtkRenderer()
    renderer.AddVolume(volume)
    camera = renderer.GetActiveCamera()
    camera.SetPosition(*scene["camera"]["position"])
    camera.SetFocalPoint(*scene["camera"]["lookAt"])
    camera.SetViewAngle(scene["camera"]["fovy"])
    camera.SetViewUp(0, 1, 0)
    shown = vtk.vtkRenderWindow()
    shown.SetOffScreenRendering(1)
    shown.SetSize(*scene["image"]["size"])
    shown.AddRenderer(renderer)
    renderer.ResetCameraClippingRange()
    shown.Render()
    return shown, mapper, renderer


def vtk_seconds(shown, mapper, renderer, repeat):
    """Processor seconds of rays alone, as the mapper needs them for one frame more."""
    seconds = []
    for _ in range(repeat):
        # Something has changed, so that the rays are cast again.
        renderer.GetActiveCamera().Modified()
        mapper.Modified()
        started = time.process_time()
        shown.Render()
        seconds.append(time.process_time() - started)
    return statistics.median(seconds)


def rayset_seconds(program, folder, side, look):
    """Processor seconds of one picture: those of a whole run, less those of a run that renders one pixel."""

    def run(*more):
        before = os.times()
        scene = os.path.join(folder, f"grid-{side}-{look}.json")
        picture = os.path.join(folder, f"grid-{side}-{look}.png")
        command = [program, "render", scene, "-o", picture, "--threads", "1", "--memory", "1GiB", *more]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        after = os.times()
        return after.children_user - before.children_user

    return run() - run("--size", "1x1")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("folder")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--picture", help="write VTK's pictures into this folder")
    args = parser.parse_args()
    try:
        import vtk
    except ImportError:
        sys.exit("this needs VTK: pip install vtk")
    vtk.vtkMultiThreader.SetGlobalMaximumNumberOfThreads(1)
    print("| grid | rayset CPU s | VTK CPU s | VTK / rayset |")
    print("| --- | ---: | ---: | ---: |")
    for side in SIDES:
        for look in LOOKS:
            shown, mapper, renderer = window(vtk, args.folder, side, look)
            ours, theirs = [], []
            for _ in range(args.runs):
                theirs.append(vtk_seconds(shown, mapper, renderer, 3))
                ours.append(rayset_seconds(args.program, args.folder, side, look))
            a, b = statistics.median(ours), statistics.median(theirs)
            print(f"| {side}³ {look} | {a:.3f} | {b:.3f} | {b / a:.2f} |", flush=True)
            if args.picture:
                image = vtk.vtkWindowToImageFilter()
                image.SetInput(shown)
                writer = vtk.vtkPNGWriter()
                writer.SetFileName(os.path.join(args.picture, f"vtk-{side}-{look}.png"))
                writer.SetInputConnection(image.GetOutputPort())
                writer.Write()


if __name__ == "__main__":
    main()
