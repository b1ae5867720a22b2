//! Pictures.

use std::io::{self, BufWriter, Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use numpy::ndarray::{Array2, Array3};
use numpy::{IntoPyArray, PyArray3};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use rayset::image::{Band, ExrBands, LayerPixel, PngBands};
use rayset::output::{Destination, OutputFile};
use rayset::storage::shown;
use rayset_inputs::Pixels;

use crate::errors;
use crate::room::{self, TooLarge};
use crate::wait::lock;

/// A picture in linear light, with layers if they were asked for.
#[pyclass(frozen, module = "rayset._native")]
pub(crate) struct Picture {
    pub(crate) picture: rayset::Picture,
    pub(crate) pixels: Pixels,
    /// The upper left corner in the whole picture, and the size of that.
    pub(crate) corner: (u32, u32),
    pub(crate) whole: (u32, u32),
}

/// Bytes in memory, which the encoder has while somebody else keeps them.
#[derive(Clone, Default)]
struct Shared(Arc<Mutex<Vec<u8>>>);

impl Write for Shared {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut held = lock(&self.0);
        held.try_reserve(bytes.len()).map_err(|_| io::ErrorKind::OutOfMemory)?;
        held.extend_from_slice(bytes);
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
        let mut png =
            PngBands::new(output, width, height, self.pixels.display_transform).map_err(|e| e.to_string())?;
        png.write(&self.band()).map_err(|e| e.to_string())?;
        png.finish().map_err(|e| e.to_string())
    }

    fn write_exr<W: Write + Seek + Send + 'static>(&self, output: W) -> Result<(), String> {
        let size = (self.picture.width, self.picture.height);
        let exr = ExrBands::with_comment(output, size, self.corner, self.whole, self.pixels.remark());
        let mut exr = exr.map_err(|e| e.to_string())?;
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
    pub(crate) fn enlarged(self, width: u32, height: u32) -> Result<Self, TooLarge> {
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
        let mut large = empty(width, height, !layers.is_empty())?;
        large.pixels.extend(places().map(|at| pixels[at]));
        if !layers.is_empty() {
            large.layers.extend(places().map(|at| layers[at]));
        }
        (large.width, large.height) = (width, height);
        Ok(Self { picture: large, whole: (width, height), ..self })
    }

    /// Its numbers as an array: as many for each pixel as it has channels.
    fn numbers<T>(&self, channels: usize) -> Result<Vec<T>, TooLarge> {
        let (width, height) = (self.picture.width, self.picture.height);
        let what = format!("the array of a picture of {width} by {height} pixels");
        room::vector(width as usize * height as usize * channels, &what, PARTS)
    }

    /// Checks that a copy fits, which is made to be written.
    fn check_copy(&self) -> PyResult<()> {
        let rayset::Picture { width, height, pixels, layers } = &self.picture;
        let each = size_of_val(&pixels[..]) + size_of_val(&layers[..]);
        let what = format!("a copy of a picture of {width} by {height} pixels, to be encoded,");
        Ok(room::check(1, each as u64, &what, PARTS)?)
    }
}

/// What to do about a picture that is too large.
const PARTS: &str = "render parts of it, by crop=, or with the program, which holds none of it";

/// A picture without pixels yet, with memory for those of `width` by `height`.
pub(crate) fn empty(width: u32, height: u32, has_layers: bool) -> Result<rayset::Picture, TooLarge> {
    let count = u64::from(width) * u64::from(height);
    let (pixel, layer) = (size_of::<[f32; 4]>(), size_of::<LayerPixel>());
    let each = pixel + if has_layers { layer } else { 0 };
    let what = format!("a picture of {width} by {height} pixels");
    room::check(count, each as u64, &what, PARTS)?;
    let count = usize::try_from(count).unwrap_or(usize::MAX);
    let pixels = room::vector(count, &what, PARTS)?;
    let layers = room::vector(if has_layers { count } else { 0 }, &what, PARTS)?;
    Ok(rayset::Picture { width: 0, height: 0, pixels, layers })
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
        let mut numbers = self.numbers::<f32>(4)?;
        py.detach(|| numbers.extend(self.picture.pixels.iter().flatten()));
        self.array(py, numbers, 4)
    }

    /// Red, green, blue and alpha, as screens show them, not multiplied by alpha.
    fn rgba8<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<u8>>> {
        let mut bytes = self.numbers::<u8>(4)?;
        py.detach(|| {
            let encode = self.pixels.display_transform.rgba8();
            bytes.extend(self.picture.pixels.iter().flat_map(|&pixel| encode(pixel)));
        });
        self.array(py, bytes, 4)
    }

    /// A layer by its name; `None` if there are none.
    fn layer(&self, py: Python<'_>, name: &str) -> PyResult<Option<Py<PyAny>>> {
        let layers = &self.picture.layers;
        if layers.is_empty() {
            return Ok(None);
        }
        let numbers = |of: fn(&LayerPixel) -> f32| self.plane(py, layers.iter().map(of));
        let counts = |of: fn(&LayerPixel) -> u32| self.plane(py, layers.iter().map(of));
        let vectors = |of: fn(&LayerPixel) -> [f32; 3]| {
            let mut numbers = self.numbers::<f32>(3)?;
            numbers.extend(layers.iter().flat_map(of));
            PyResult::Ok(self.array(py, numbers, 3)?.into_any().unbind())
        };
        Ok(Some(match name {
            "depth" => numbers(|layer| layer.depth)?,
            "opacity" => numbers(|layer| layer.opacity)?,
            "normal" => vectors(|layer| layer.normal)?,
            "albedo" => vectors(|layer| layer.albedo)?,
            "instance" => counts(|layer| layer.instance)?,
            "samples" => counts(|layer| layer.samples)?,
            "bytes" => numbers(|layer| layer.bytes)?,
            "lod_error" => numbers(|layer| layer.lod_error)?,
            _ => return Err(errors::value(format!("no layer is called {name}"))),
        }))
    }

    /// The picture as a file in PNG.
    fn png<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        self.check_copy()?;
        let bytes = py.detach(|| {
            let bytes = Shared::default();
            self.write_png(bytes.clone()).map(|()| std::mem::take(&mut *lock(&bytes.0)))
        });
        bytes.map(|bytes| PyBytes::new(py, &bytes)).map_err(errors::value)
    }

    /// Writes a PNG, or an OpenEXR if the name ends in `.exr`.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        self.check_copy()?;
        py.detach(|| self.save_as(&path)).map_err(|error| {
            let name = shown(&path);
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

    fn plane<T: numpy::Element>(
        &self,
        py: Python<'_>,
        values: impl Iterator<Item = T>,
    ) -> PyResult<Py<PyAny>> {
        let mut numbers = self.numbers::<T>(1)?;
        numbers.extend(values);
        let shape = (self.picture.height as usize, self.picture.width as usize);
        let array = Array2::from_shape_vec(shape, numbers).map_err(|e| errors::value(e.to_string()))?;
        Ok(array.into_pyarray(py).into_any().unbind())
    }
}
