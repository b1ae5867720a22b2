"""The viewer in a real browser, as `.ci/browser` tests it."""
