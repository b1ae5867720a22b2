"""Colours, opacity, and what the page says of them."""
import subprocess

from PIL import Image

from browser.people import PROGRAM, Person, Server, drag, test


@test("sheet.ply")
def colours_by_an_attribute_are_those_of_the_command_that_the_page_shows(browser, server, folder):
    person = Person(browser, server, width=720, height=480)
    plain, _ = person.pixels()
    person.page.get_by_label("Colours", exact=True).select_option("warmth")
    person.page.get_by_label("Colour map", exact=True).select_option("plasma")
    warm, _ = person.pixels()
    assert warm != plain
    legend = person.evaluate("rayset.view.legend.transferFunction")
    assert legend["color"] == "plasma" and legend["input"] == "warmth", legend
    # All but a hundredth at either end of 0 to 200.
    assert abs(legend["valueRange"][0]) < 10 and abs(legend["valueRange"][1] - 200) < 10, legend
    bar = person.page.locator("canvas.bar")
    assert "warmth" in bar.get_attribute("aria-label")
    person.page.get_by_label("value at the upper end of the colour map").fill("150")
    person.page.get_by_label("value at the upper end of the colour map").blur()
    hot, size = person.pixels()
    assert hot != warm
    person.is_what_render_makes(folder)
    person.shot("attribute")
    # The command says the same.
    words, _ = person.command()
    assert words[:2] == ["rayset", "render"] and "--color-by=warmth" in words, words
    subprocess.run([PROGRAM, *words[1:]], check=True, capture_output=True, cwd=folder)
    image = Image.open(folder / "picture.png").convert("RGBA")
    assert image.size == size and image.tobytes() == hot, "the command's picture is another"
    person.page.get_by_label("Point radius").focus()
    for _ in range(4):
        person.page.keyboard.press("ArrowRight")
    assert person.pixels()[0] != hot and person.evaluate("rayset.view.changes.style.radiusScale") == 2
    person.is_what_render_makes(folder)
    # Other looks are those of `render`, too.
    person.page.get_by_label("Look", exact=True).select_option("gas")
    gas, _ = person.pixels()
    assert gas != hot
    person.is_what_render_makes(folder)
    person.shot("gas")
    person.page.get_by_label("Look", exact=True).select_option("classes")
    person.wait("document.getElementById('status').textContent.includes('no classes')")
    person.page.keyboard.press("Control+z")
    assert person.pixels()[0] == gas
    person.well()


@test("points.ply")
def opacity_is_edited_on_the_histogram_with_the_keyboard_alone(browser, server, folder):
    person = Person(browser, server, width=720, height=480)
    person.page.get_by_label("Look", exact=True).select_option("gas")
    before, _ = person.pixels()
    points = person.page.locator(".curve circle")
    assert 2 <= points.count() <= 10 and person.page.locator(".curve rect").count() > 10
    points.nth(points.count() // 2).focus()
    for _ in range(12):
        person.page.keyboard.press("ArrowUp")
    after, _ = person.pixels()
    assert after != before
    person.is_what_render_makes(folder)
    # Dragged far beyond its edge, a point stays on it.
    handle = points.last.bounding_box()
    drag(person.page, (600, -20), (handle["x"] + handle["width"] / 2, handle["y"] + handle["height"] / 2), steps=80)
    largest = person.evaluate("rayset.view.changes.style.opacity.at(-1)[0]")
    assert largest <= person.evaluate("rayset.view.legend.densities.high") * 1.01, largest
    person.converged()
    count = points.count()
    points.nth(1).focus()
    person.page.keyboard.press("Delete")
    assert points.count() == count - 1
    person.page.get_by_role("button", name="Reset opacity to that of the look").click()
    assert person.pixels()[0] == before
    person.well()


@test()
def options_of_the_command_line_are_on_the_page(browser, folder):
    options = ["--color-by", "warmth", "--colormap", "magma", "--value-range", "10:150", "--log", "--radius-scale", "2"]
    server = Server(folder / "sheet.ply", folder, options=options)
    person = Person(browser, server, width=720, height=480)
    first, _ = person.pixels()
    person.is_what_render_makes(folder)
    assert person.page.get_by_label("Logarithmic").is_checked()
    assert person.page.get_by_label("Point radius").input_value() == "1"
    assert person.page.get_by_label("Colours", exact=True).input_value() == "warmth"
    person.page.get_by_label("Logarithmic").uncheck()
    assert person.pixels()[0] != first
    command, _ = person.command()
    assert "--log" not in command and "--radius-scale=2" in command and "--colormap=magma" in command, command
    person.is_what_render_makes(folder)
    person.well()
    server.end()
