//! The module `rayset._native`: the engine, as the package's own Python uses it. What people call
//! is in `rayset/*.py`; arguments come here checked and in one form.

mod aggregates;
mod arrays;
mod build;
mod chunks;
mod errors;
mod files;
mod image;
mod looks;
mod parts;
mod points;
mod remote;
mod render;
mod room;
mod steps;
mod temporary;
mod voxels;
mod wait;

use pyo3::prelude::*;

/// Classes and functions of the engine.
#[pymodule]
fn _native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    remote::open_addresses(module.py())?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_function(wrap_pyfunction!(remote::read_text, module)?)?;
    module.add_function(wrap_pyfunction!(remote::beside, module)?)?;
    module.add_function(wrap_pyfunction!(remote::shown, module)?)?;
    module.add_function(wrap_pyfunction!(remote::versions, module)?)?;
    module.add_class::<files::CloudFile>()?;
    module.add_class::<files::GridFile>()?;
    module.add_class::<image::Picture>()?;
    module.add_class::<temporary::TemporaryFolder>()?;
    module.add_class::<render::Session>()?;
    module.add_class::<render::Passes>()?;
    module.add_function(wrap_pyfunction!(build::build_arrays, module)?)?;
    module.add_function(wrap_pyfunction!(build::build_chunks, module)?)?;
    module.add_function(wrap_pyfunction!(points::expand, module)?)?;
    module.add_function(wrap_pyfunction!(points::build_files, module)?)?;
    module.add_function(wrap_pyfunction!(steps::next_step, module)?)?;
    module.add_function(wrap_pyfunction!(steps::read_part, module)?)?;
    module.add_function(wrap_pyfunction!(steps::read_arrays_part, module)?)?;
    module.add_function(wrap_pyfunction!(steps::run_step, module)?)?;
    module.add_function(wrap_pyfunction!(steps::merge_parts, module)?)?;
    module.add_function(wrap_pyfunction!(voxels::build_grid, module)?)?;
    module.add_function(wrap_pyfunction!(parts::cameras, module)?)?;
    module.add_function(wrap_pyfunction!(parts::render_part, module)?)?;
    module.add_function(wrap_pyfunction!(parts::join_parts, module)?)?;
    module.add_function(wrap_pyfunction!(parts::join_coarse, module)?)?;
    module.add_function(wrap_pyfunction!(parts::share_costs, module)?)?;
    module.add_function(wrap_pyfunction!(parts::instructions, module)?)?;
    module.add_function(wrap_pyfunction!(files::open_files, module)?)?;
    module.add_function(wrap_pyfunction!(files::open_bytes, module)?)?;
    module.add_function(wrap_pyfunction!(looks::colormap, module)?)?;
    module.add_function(wrap_pyfunction!(looks::colormaps, module)?)?;
    module.add_function(wrap_pyfunction!(looks::look_options, module)?)?;
    module.add_function(wrap_pyfunction!(looks::size_of, module)?)
}
