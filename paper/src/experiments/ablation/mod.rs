//! What each idea is worth: of the reference engine, of the engine that ships, and of octants.

mod cells;
mod reference;
mod shipping;

use anyhow::Result;

use super::Setting;

pub(super) fn run(setting: &Setting) -> Result<()> {
    reference::run(setting)?;
    reference::streaming(setting)?;
    shipping::run(setting)?;
    cells::run(setting)
}
