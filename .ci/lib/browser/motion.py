"""Pictures that move: where each place is, what is in the way, and what nobody has seen."""
import math
import time

from browser.inputs import sheet_height
from browser.people import Person, drag, test


@test("points.ply")
def a_moving_picture_shows_each_place_where_the_camera_sees_it(browser, server, _folder):
    person = Person(browser, server)
    # A wall five units away with a red stripe in its middle, and beside it nothing.
    found = person.evaluate("""(async () => {
        const { Warp } = await import("./warp.js");
        const [columns, rows] = [200, 100];
        const picture = document.createElement("canvas");
        [picture.width, picture.height] = [columns, rows];
        const context = picture.getContext("2d");
        context.fillStyle = "#00f";
        context.fillRect(0, 0, columns, rows);
        context.fillStyle = "#f00";
        context.fillRect(98, 0, 4, rows);
        const camera = { position: [1e6, 0, 5], direction: [0, 0, -1], up: [0, 1, 0], fovy: 53.13010235415598, distance: 5 };
        const parts = new Uint16Array(columns * rows);
        for (let at = 0; at < parts.length; at++) {
            const [x, y] = [(2 * (at % columns) + 1) / columns - 1, 1 - (2 * Math.floor(at / columns) + 1) / rows];
            // Distances along the rays of a wall across the view: half the tangent is a half, the picture twice as wide as high.
            parts[at] = 65535 / Math.hypot(x, 0.5 * y, 1);
        }
        const warp = new Warp();
        warp.take(camera, { columns, rows, nearest: 5, farthest: 5 * Math.hypot(1, 0.5, 1), parts }, picture, 2);
        const red = (moved) => {
            const drawn = warp.draw({ ...camera, position: [1e6 + moved, 0, 5] }, 2);
            const data = drawn.getContext("2d").getImageData(0, 50, columns, 1).data;
            const at = [...Array(columns).keys()].filter((i) => data[4 * i] > 128);
            return [Math.min(...at), Math.max(...at)];
        };
        return [red(0), red(1), red(-2)];
    })()""")
    # One unit is a tenth of the wall's width, 20 pixels.
    for (left, right), wanted in zip(found, (98, 78, 138)):
        assert abs(left - wanted) <= 1 and abs(right - wanted - 3) <= 1, found
    person.well()


def notches(person, count, way, at=(0.5, 0.5)):
    """Turns the wheel by so many notches: towards what is seen, `way` -1, or away from it."""
    person.page.mouse.move(*person.at(*at))
    for _ in range(count):
        person.page.mouse.wheel(0, 100 * way)
        person.page.wait_for_timeout(25)


def eye(person):
    return person.camera()["position"]


@test("ball.json")
def nobody_comes_through_a_surface_unless_shift_is_held(browser, server, _folder):
    person = Person(browser, server, width=720, height=480)
    person.converged()
    notches(person, 70, -1)
    far = math.hypot(*eye(person))
    assert 1 < far < 1.5, f"the wheel stops {far} from the middle of a ball of radius 1"
    person.page.get_by_role("button", name="Show all").click()
    person.converged()
    person.page.locator("#picture").focus()
    person.page.keyboard.down("w")
    time.sleep(6)
    person.page.keyboard.up("w")
    far = math.hypot(*eye(person))
    assert 1 <= far < 2, f"W stops {far} from the middle of a ball of radius 1"
    # With Shift, the ball is no obstacle.
    person.page.keyboard.down("Shift")
    notches(person, 30, -1)
    person.page.keyboard.up("Shift")
    assert person.camera()["distance"] > 0
    along = sum(p * d for p, d in zip(eye(person), person.camera()["direction"]))
    assert along > 0, f"with Shift the eye has come {along} beyond the middle"
    person.well()


@test("sheet.ply")
def the_ground_stops_who_comes_down_at_a_slant(browser, server, _folder):
    person = Person(browser, server, width=720, height=480)
    person.converged()
    drag(person.page, (0, -40))
    person.converged()
    for at in ((0.5, 0.5), (0.4, 0.55)):
        notches(person, 40, -1, at)
        x, y, z = eye(person)
        ground = sheet_height(x + 100, y + 100)
        assert z > ground, f"the eye is at {z}, the ground at {ground}"
        person.converged()
        person.page.get_by_role("button", name="Show all").click()
        person.converged()
    person.well()


@test("ball.json")
def going_away_ends_where_the_scene_is_still_seen(browser, server, _folder):
    person = Person(browser, server, width=720, height=480)
    person.converged()
    notches(person, 120, 1)
    far = math.hypot(*eye(person))
    notches(person, 20, 1)
    assert math.hypot(*eye(person)) <= far * 1.001, "it ends"
    # A ball of radius 1 in a picture of 480 rows: it covers some of them.
    assert far < 60, f"{far} away"
    person.page.keyboard.press("h")
    person.page.get_by_label("Orthographic").check()
    notches(person, 120, 1)
    assert person.camera()["height"] < 120
    person.well()


@test("sheet.ply")
def what_is_dragged_along_stays_under_the_pointer_however_far_it_is(browser, server, _folder):
    person = Person(browser, server, width=720, height=480)
    person.converged()
    for at in ((0.5, 0.62), (0.5, 0.45), (0.6, 0.5)):
        person.converged()
        start = person.at(*at)
        place = person.evaluate(f"rayset.view.pick({at[0]}, {at[1]})")["position"]
        person.page.mouse.move(*start)
        person.page.mouse.down(button="right")
        person.page.mouse.move(start[0] + 70, start[1] + 25, steps=9)
        person.page.mouse.up(button="right")
        box = person.page.locator("#picture").bounding_box()
        seen = person.evaluate(
            f"import('./camera.js').then((m) => m.project(rayset.view.camera, {place}, {box['width'] / box['height']}))")
        now = person.at((seen[0] + 1) / 2, (1 - seen[1]) / 2)
        assert math.dist(now, (start[0] + 70, start[1] + 25)) < 4, f"{at}: {now} and not {start} + (70, 25)"
    person.well()


@test("ball.json")
def a_pinch_on_a_pad_comes_nearer_as_far_as_the_fingers_spread(browser, server, _folder):
    person = Person(browser, server, width=720, height=480)
    person.converged()
    before = math.hypot(*eye(person)) - 1
    person.page.mouse.move(*person.at(0.5, 0.5))
    # Browsers tell of it as a wheel with Ctrl, a hundredth of the logarithm of the factor a pixel: here to half.
    person.page.keyboard.down("Control")
    for _ in range(10):
        person.page.mouse.wheel(0, -7)
        person.page.wait_for_timeout(30)
    person.page.keyboard.up("Control")
    after = math.hypot(*eye(person)) - 1
    assert 0.4 < after / before < 0.6, f"from {before} to {after}"
    person.well()


@test("points.ply")
def a_moved_picture_has_no_colour_where_nothing_was_seen(browser, server, _folder):
    person = Person(browser, server)
    # A red post before a blue wall that ends to the right, before green nothing; its left edge is blurred as JPEG blurs it.
    found = person.evaluate("""(async () => {
        const { Warp } = await import("./warp.js");
        const [columns, rows] = [200, 100];
        const picture = document.createElement("canvas");
        [picture.width, picture.height] = [columns, rows];
        const context = picture.getContext("2d");
        const paint = (color, from, to) => ((context.fillStyle = color), context.fillRect(from, 0, to - from, rows));
        paint("#0f0", 0, columns);
        paint("#00f", 0, 160);
        paint("#f00", 80, 100);
        paint("#808", 78, 80);
        paint("#808", 100, 102);
        paint("#088", 160, 162);
        const camera = { position: [0, 0, 0], direction: [0, 0, -1], up: [0, 1, 0], fovy: 53.13010235415598, distance: 5 };
        const parts = new Uint16Array(columns * rows);
        const [near, far] = [2, 10];
        for (let at = 0; at < parts.length; at++) {
            const column = at % columns;
            const [x, y] = [(2 * column + 1) / columns - 1, 1 - (2 * Math.floor(at / columns) + 1) / rows];
            const ahead = column >= 80 && column < 100 ? near : far;
            if (column < 160) parts[at] = (65535 * near) / (ahead * Math.hypot(x, 0.5 * y, 1));
        }
        const warp = new Warp();
        warp.take(camera, { columns, rows, nearest: near, farthest: 15, parts }, picture, 2);
        const drawn = warp.draw({ ...camera, position: [0.5, 0, 0] }, 2);
        const data = drawn.getContext("2d").getImageData(0, 50, columns, 1).data;
        return [...Array(columns).keys()].map((i) => [...data.subarray(4 * i, 4 * i + 3)]);
    })()""")
    red = [i for i, (r, g, b) in enumerate(found) if r > 60]
    blue = [i for i, (r, g, b) in enumerate(found) if b > 60]
    # The post moves by 25 pixels, the wall by 5: between them 20 that nobody has seen, at the wall's end nothing.
    assert abs(min(red) - 55) <= 1 and abs(max(red) - 75) <= 2, (min(red), max(red))
    assert not [i for i in blue if i in red], "the post's colour is on the wall"
    assert not [i for i in blue if 77 < i < 93], [i for i in blue if 77 < i < 93]
    assert max(blue) <= 156, max(blue)
    assert all(found[i] == [0, 255, 0] for i in range(158, 200)), "nothing is as it is at its own place, to the picture's end"
    person.well()


@test("points.ply")
def at_rest_nothing_coarse_is_drawn_over_something_finer(browser, server, _folder):
    person = Person(browser, server)
    person.converged()
    # Drawings tell of no generation; what is told of a frame follows its drawing, before the next one is drawn.
    person.evaluate("""(() => {
        const context = document.querySelector("#picture").getContext("2d");
        [window.drawn, window.said] = [[], []];
        const { drawImage, putImageData } = context;
        const note = (width, isMoved) => window.drawn.push({ at: performance.now(), width, isMoved });
        context.drawImage = (image, ...rest) => {
            note(image.width, image instanceof HTMLCanvasElement);
            drawImage.call(context, image, ...rest);
        };
        context.putImageData = (...rest) => {
            note(1e9, false);
            putImageData.apply(context, rest);
        };
        const { send } = WebSocket.prototype;
        WebSocket.prototype.send = function (text) {
            const message = JSON.parse(text);
            if (message.type === "show") window.said.push({ at: performance.now(), generation: message.generation });
            send.call(this, text);
        };
        rayset.view.addEventListener("frame", ({ detail }) => {
            for (const each of window.drawn) if (!each.isMoved) each.generation ??= detail.generation;
        });
        rayset.view.addEventListener("change", () => (window.changed = performance.now()));
    })()""")
    for by in ((120, 30), (-60, 10), (20, -40)):
        drag(person.page, by)
        person.converged()
        # Until a picture from where the camera rests has come, others are better than none, and are moved there.
        found = person.evaluate("""(() => {
            const wanted = window.said.find(({ at }) => at >= window.changed).generation;
            const first = window.drawn.findIndex(({ generation }) => generation >= wanted);
            return window.drawn.slice(first).map(({ width, isMoved, generation }) => [width, !isMoved && generation >= wanted]);
        })()""")
        widths = [width for width, _ in found]
        assert found and widths == sorted(widths) and all(is_wanted for _, is_wanted in found), f"by rays in a row: {found[:8]}"
    # The same from where one stands, in another light: it is not blurred by what was seen before.
    person.evaluate("(window.drawn = []), (rayset.view.changes = { ...rayset.view.changes, exposure: 1 })")
    person.converged()
    said = person.evaluate("window.drawn.map(({ width, isMoved }) => [width, isMoved])")
    assert said == sorted(said) and not any(is_moved for _, is_moved in said), said[:8]
    person.well()
