//! Pictures.

use std::io::{self, BufWriter, Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use numpy::ndarray::{Array2, Array3};
use numpy::{IntoPyArray, PyArray3};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use rayset::image::{Band, DisplayTransform, ExrBands, LayerPixel, PngBands};
use rayset::output::{Destination, OutputFile};

use crate::errors;
use crate::wait::lock;

/// A picture in linear light, with layers if they were asked for.
#[pyclass(frozen, module = "rayset._native")]
pub(crate) struct Picture {
    pub(crate) picture: rayset::Picture,
    pub(crate) display: DisplayTransform,
    /// The upper left corner in the whole picture, and the size of that.
    pub(crate) corner: (u32, u32),
    pub(crate) whole: (u32, u32),
}

/// Bytes in memory, which the encoder has while somebody else keeps them.
#[derive(Clone, Default)]
struct Shared(Arc<Mutex<Vec<u8>>>);

impl Write for Shared {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        lock(&self.0).extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Picture {
    fn band(&self) -> Band {
        let rayset::Picture { width, pixels, layers, .. } = &self.picture;
        let mut band = Band::new(self.corner.1, *width, 0, false);
        band.pixels.clone_from(pixels);
        band.layers.clone_from(layers);
        band
    }

    fn write_png(&self, output: impl Write + 'static) -> Result<(), String> {
        let (width, height) = (self.picture.width, self.picture.height);
        let mut png = PngBands::new(output, width, height, self.display).map_err(|e| e.to_string())?;
        png.write(&self.band()).map_err(|e| e.to_string())?;
        png.finish().map_err(|e| e.to_string())
    }

    fn write_exr<W: Write + Seek + Send + 'static>(&self, output: W) -> Result<(), String> {
        let size = (self.picture.width, self.picture.height);
        let mut exr = ExrBands::new(output, size, self.corner, self.whole).map_err(|e| e.to_string())?;
        exr.write(&self.band()).map_err(|e| e.to_string())?;
        exr.finish().map_err(|e| e.to_string())
    }

    fn save_as(&self, path: &Path) -> Result<(), String> {
        let file = OutputFile::create(&Destination::new(path).map_err(|e| e.to_string())?)
            .map_err(|e| e.to_string())?;
        let output = BufWriter::new(file.writer());
        if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("exr")) {
            self.write_exr(output)?;
        } else {
            self.write_png(output)?;
        }
        file.publish().map_err(|e| e.to_string())
    }

    /// The same picture with each pixel as a block, for a picture of `width` by `height`.
    pub(crate) fn enlarged(self, width: u32, height: u32) -> Self {
        let rayset::Picture { width: own_width, height: own_height, pixels, layers } = self.picture;
        let places = || {
            (0..height).flat_map(move |y| {
                let row = u64::from(y) * u64::from(own_height) / u64::from(height);
                (0..width).map(move |x| {
                    let column = u64::from(x) * u64::from(own_width) / u64::from(width);
                    (row * u64::from(own_width) + column) as usize
                })
            })
        };
        let layers = if layers.is_empty() { layers } else { places().map(|at| layers[at]).collect() };
        let pixels = places().map(|at| pixels[at]).collect();
        Self { picture: rayset::Picture { width, height, pixels, layers }, whole: (width, height), ..self }
    }
}

#[pymethods]
impl Picture {
    /// Width and height.
    #[getter]
    fn size(&self) -> (u32, u32) {
        (self.picture.width, self.picture.height)
    }

    #[getter]
    fn has_layers(&self) -> bool {
        !self.picture.layers.is_empty()
    }

    /// Red, green, blue and alpha in linear light, multiplied by alpha.
    fn linear<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        self.array(py, self.picture.pixels.concat(), 4)
    }

    /// Red, green, blue and alpha, as screens show them, not multiplied by alpha.
    fn rgba8<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<u8>>> {
        let bytes = py.detach(|| {
            let encode = self.display.rgba8();
            self.picture.pixels.iter().flat_map(|&pixel| encode(pixel)).collect()
        });
        self.array(py, bytes, 4)
    }

    /// A layer by its name; `None` if there are none.
    fn layer(&self, py: Python<'_>, name: &str) -> PyResult<Option<Py<PyAny>>> {
        let layers = &self.picture.layers;
        if layers.is_empty() {
            return Ok(None);
        }
        let numbers = |of: fn(&LayerPixel) -> f32| self.plane(py, layers.iter().map(of).collect());
        let counts = |of: fn(&LayerPixel) -> u32| self.plane(py, layers.iter().map(of).collect());
        let vectors = |of: fn(&LayerPixel) -> [f32; 3]| {
            PyResult::Ok(self.array(py, layers.iter().flat_map(of).collect(), 3)?.into_any().unbind())
        };
        Ok(Some(match name {
            "depth" => numbers(|layer| layer.depth)?,
            "opacity" => numbers(|layer| layer.opacity)?,
            "normal" => vectors(|layer| layer.normal)?,
            "albedo" => vectors(|layer| layer.albedo)?,
            "instance" => counts(|layer| layer.instance)?,
            "samples" => counts(|layer| layer.samples)?,
            "bytes" => numbers(|layer| layer.bytes)?,
            _ => return Err(errors::value(format!("no layer is called {name}"))),
        }))
    }

    /// The picture as a file in PNG.
    fn png<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let bytes = py.detach(|| {
            let bytes = Shared::default();
            self.write_png(bytes.clone()).map(|()| std::mem::take(&mut *lock(&bytes.0)))
        });
        bytes.map(|bytes| PyBytes::new(py, &bytes)).map_err(errors::value)
    }

    /// Writes a PNG, or an OpenEXR if the name ends in `.exr`.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        py.detach(|| self.save_as(&path)).map_err(|error| {
            let name = path.display().to_string();
            errors::os(if error.contains(&name) { error } else { format!("cannot write {name}: {error}") })
        })
    }
}

impl Picture {
    fn array<'py, T: numpy::Element>(
        &self,
        py: Python<'py>,
        numbers: Vec<T>,
        channels: usize,
    ) -> PyResult<Bound<'py, PyArray3<T>>> {
        let shape = (self.picture.height as usize, self.picture.width as usize, channels);
        let array = Array3::from_shape_vec(shape, numbers).map_err(|e| errors::value(e.to_string()))?;
        Ok(array.into_pyarray(py))
    }

    fn plane<T: numpy::Element>(&self, py: Python<'_>, numbers: Vec<T>) -> PyResult<Py<PyAny>> {
        let shape = (self.picture.height as usize, self.picture.width as usize);
        let array = Array2::from_shape_vec(shape, numbers).map_err(|e| errors::value(e.to_string()))?;
        Ok(array.into_pyarray(py).into_any().unbind())
    }
}
