//! What stands for pages in programs whose files are not open yet.

/// In place of pages: a program is compiled before its files are opened.
pub(super) struct Unopened;
