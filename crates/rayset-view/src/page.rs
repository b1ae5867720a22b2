//! The files of the page, which are part of the program.

use axum::http::{HeaderValue, header};
use axum::response::{IntoResponse, Response};

/// A file of the page.
#[derive(Clone, Copy)]
pub(crate) struct PageFile {
    name: &'static str,
    text: &'static str,
}

macro_rules! files {
    ($($name:literal),*) => {
        [$(PageFile { name: $name, text: include_str!(concat!("page/", $name)) }),*]
    };
}

const FILES: [PageFile; 23] = files!(
    "index.html",
    "icon.svg",
    "style.css",
    "app.js",
    "view.js",
    "camera.js",
    "frames.js",
    "gestures.js",
    "warp.js",
    "motion.js",
    "history.js",
    "colors.js",
    "panels.js",
    "widgets.js",
    "overlay.js",
    "views.js",
    "look.js",
    "transfer.js",
    "light.js",
    "cuts.js",
    "picks.js",
    "out.js",
    "engine.js"
);

/// The file of a name; `None` if the page has none.
pub(crate) fn file(name: &str) -> Option<PageFile> {
    FILES.into_iter().find(|file| file.name == name)
}

/// A file as an answer.
pub(crate) fn response(file: PageFile) -> Response {
    let kind = match file.name.rsplit_once('.') {
        Some((_, "html")) => "text/html; charset=utf-8",
        Some((_, "svg")) => "image/svg+xml",
        Some((_, "css")) => "text/css; charset=utf-8",
        _ => "text/javascript; charset=utf-8",
    };
    ([(header::CONTENT_TYPE, HeaderValue::from_static(kind))], file.text).into_response()
}
