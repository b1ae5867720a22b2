//! The folder through which the parts of a build exchange their results, and the files in it.
//!
//! Every part of a step writes `STEP-PART-of-PARTS.part`: a head that says what it is, and a
//! payload of a few megabytes at most (totals, counts). Where records or pieces of the cloud come
//! out of it, they are in a file beside it, which ends in `.data` and is complete before the
//! `.part` appears. All get their names only once they are complete, so a killed process leaves at
//! most a partial file, which the next run of the same step of the same part removes.
//!
//! A `.part` is `RSETPART`, the version (4 bytes), the lengths of head (4) and payload (8), the
//! CRC-32C of all that but itself (4), the head as JSON, the payload. Numbers are little-endian.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use super::super::error::BuildError;
use super::step::BuildStep;
use rayset_store::container::{Reader, Writer};
use rayset_store::output::{Destination, OutputFile, remove_partials};

const MAGIC: &[u8; 8] = b"RSETPART";
const VERSION: u32 = 3;
/// Bytes before the head.
const FRONT_BYTES: usize = 28;
/// Largest `.part` that is read.
const MOST_BYTES: u64 = 256 << 20;
/// Largest number of parts: every part of some steps has a file of each open at once.
pub(super) const MOST_PARTS: u32 = 512;

/// What a part says of itself.
#[derive(Clone, Debug, Default, serde::Deserialize, serde::Serialize)]
pub(super) struct Head {
    /// The version of the program; those of others are refused.
    pub(super) program: String,
    pub(super) step: String,
    pub(super) part: u32,
    pub(super) parts: u32,
    /// What the caller says of inputs and options.
    pub(super) request: String,
    /// What all parts of `read` together are; empty for these.
    pub(super) run: String,
    /// Size of the data file in bytes; `None` if there is none.
    pub(super) data_bytes: Option<u64>,
}

/// A part that was read.
#[derive(Debug)]
pub(super) struct Part {
    pub(super) path: PathBuf,
    pub(super) head: Head,
    pub(super) payload: Vec<u8>,
}

impl Part {
    /// An error that says what is wrong with this part.
    pub(super) fn wrong(&self, what: impl Into<String>) -> BuildError {
        BuildError::Part { path: self.path.clone(), what: what.into() }
    }
}

/// The folder, and the number of parts.
#[derive(Clone, Debug)]
pub(super) struct Exchange {
    pub(super) folder: PathBuf,
    pub(super) parts: u32,
}

impl Exchange {
    /// The file of a part.
    pub(super) fn part_path(&self, step: BuildStep, part: u32) -> PathBuf {
        self.folder.join(format!("{step}-{part}-of-{}.part", self.parts))
    }

    /// The file of its data.
    pub(super) fn data_path(&self, step: BuildStep, part: u32) -> PathBuf {
        self.folder.join(format!("{step}-{part}-of-{}.data", self.parts))
    }

    /// Creates the folder, unless it is there.
    pub(super) fn create(&self) -> Result<(), BuildError> {
        match std::fs::create_dir(&self.folder) {
            Err(e) if e.kind() != io::ErrorKind::AlreadyExists => {
                Err(BuildError::Io { action: "create", path: self.folder.clone(), source: e })
            }
            _ => Ok(()),
        }
    }

    /// A data file of a part, to be written in any order.
    pub(super) fn create_data(&self, step: BuildStep, part: u32) -> Result<DataFile, BuildError> {
        let destination = Destination::new(self.data_path(step, part))?;
        let file = OutputFile::create(&destination)?;
        Ok(DataFile { file, destination })
    }

    /// Writes a part; an earlier one is replaced.
    pub(super) fn write(
        &self,
        step: BuildStep,
        part: u32,
        head: Head,
        payload: &[u8],
    ) -> Result<(), BuildError> {
        let head = Head {
            program: env!("CARGO_PKG_VERSION").to_owned(),
            step: step.name().to_owned(),
            part,
            parts: self.parts,
            ..head
        };
        let path = self.part_path(step, part);
        let io = |source| BuildError::Io { action: "write", path: path.clone(), source };
        let head = serde_json::to_vec(&head).map_err(|e| io(e.into()))?;
        let mut front = Writer::default();
        front.put(MAGIC);
        front.u32(VERSION);
        front.u32(head.len() as u32);
        front.u64(payload.len() as u64);
        let checksum = checksum(&front.bytes, &head, payload);
        front.u32(checksum);
        let file = OutputFile::create(&Destination::new(&path)?)?;
        let mut writer = file.writer();
        for bytes in [&front.bytes, &head, payload] {
            writer.write_all(bytes).map_err(io)?;
        }
        Ok(file.publish_volatile()?)
    }

    /// Reads a part; `None` if it is not there.
    pub(super) fn read(&self, step: BuildStep, part: u32) -> Result<Option<Part>, BuildError> {
        let path = self.part_path(step, part);
        let wrong = |what: String| BuildError::Part { path: path.clone(), what };
        let io = |source| BuildError::Io { action: "read", path: path.clone(), source };
        match std::fs::metadata(&path) {
            Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(e) => return Err(io(e)),
            Ok(found) if found.len() > MOST_BYTES => return Err(wrong("it is too large for a part".into())),
            Ok(_) => {}
        }
        let bytes = match std::fs::read(&path) {
            Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(None),
            read => read.map_err(io)?,
        };
        let (head, payload) = decode(&bytes).map_err(&wrong)?;
        let head: Head = serde_json::from_slice(head).map_err(|e| wrong(format!("its head: {e}")))?;
        if head.program != env!("CARGO_PKG_VERSION") {
            let own = env!("CARGO_PKG_VERSION");
            return Err(wrong(format!("it is of rayset {}, and this is {own}", head.program)));
        }
        if (head.step.as_str(), head.part, head.parts) != (step.name(), part, self.parts) {
            let what = format!("it is part {} of {} of `{}`, renamed", head.part, head.parts, head.step);
            return Err(wrong(what));
        }
        let payload = payload.to_vec();
        Ok(Some(Part { path, head, payload }))
    }

    /// All parts of a step, one after another; an error that names those that are missing.
    pub(super) fn read_all(
        &self,
        step: BuildStep,
        mut visit: impl FnMut(Part) -> Result<(), BuildError>,
    ) -> Result<(), BuildError> {
        let mut missing = Vec::new();
        for part in 1..=self.parts {
            match self.read(step, part)? {
                Some(found) if missing.is_empty() => visit(found)?,
                Some(_) => {}
                None => missing.push(part),
            }
        }
        if missing.is_empty() {
            return Ok(());
        }
        Err(BuildError::MissingParts { folder: self.folder.clone(), step, parts: self.parts, missing })
    }

    /// Opens the data of a part.
    pub(super) fn open_data(&self, part: &Part) -> Result<std::fs::File, BuildError> {
        let path = part.path.with_extension("data");
        let file = rayset_base::regular_file::open(&path).and_then(|file| Ok((file.metadata()?.len(), file)));
        let (bytes, file) =
            file.map_err(|source| BuildError::Io { action: "read", path: path.clone(), source })?;
        let expected = part.head.data_bytes.unwrap_or(0);
        if bytes != expected {
            let what = format!("it has {bytes} bytes, where {expected} were written; run that step again");
            return Err(BuildError::Part { path, what });
        }
        Ok(file)
    }

    /// Removes the data of a part, which is not needed any more.
    pub(super) fn remove_data(&self, step: BuildStep, part: u32) {
        // What stays goes with the folder.
        let _ = std::fs::remove_file(self.data_path(step, part));
    }

    /// Removes everything that parts have written, and the folder if nothing else is in it.
    pub(super) fn remove(&self) -> Result<(), BuildError> {
        let io = |source| BuildError::Io { action: "remove", path: self.folder.clone(), source };
        for step in BuildStep::ALL {
            for part in 1..=self.parts {
                for path in [self.part_path(step, part), self.data_path(step, part)] {
                    match std::fs::remove_file(&path) {
                        Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(io(e)),
                        _ => {}
                    }
                }
            }
        }
        remove_partials(&self.folder, |output| numbers_of(output).is_some());
        // Others' files may be in it, or others be removing it.
        let _ = std::fs::remove_dir(&self.folder);
        Ok(())
    }

    /// The numbers of parts of which a folder has files.
    pub(super) fn found(folder: &Path) -> Result<Vec<u32>, BuildError> {
        let io = |source| BuildError::Io { action: "read", path: folder.to_owned(), source };
        let mut found = Vec::new();
        for entry in std::fs::read_dir(folder).map_err(io)? {
            let name = entry.map_err(io)?.file_name();
            let parts = name.to_str().filter(|name| name.ends_with(".part")).and_then(numbers_of);
            found.extend(parts);
        }
        found.sort_unstable();
        found.dedup();
        Ok(found)
    }
}

/// The number of parts in the name of a file of a part; `None` for other names.
fn numbers_of(name: &str) -> Option<u32> {
    let stem = name.strip_suffix(".part").or_else(|| name.strip_suffix(".data"))?;
    let rest = BuildStep::ALL.iter().find_map(|step| stem.strip_prefix(step.name())?.strip_prefix('-'))?;
    let (part, parts) = rest.split_once("-of-")?;
    let (part, parts): (u32, u32) = (part.parse().ok()?, parts.parse().ok()?);
    ((1..=parts).contains(&part) && parts <= MOST_PARTS).then_some(parts)
}

fn checksum(front: &[u8], head: &[u8], payload: &[u8]) -> u32 {
    crc32c::crc32c_append(crc32c::crc32c_append(crc32c::crc32c(front), head), payload)
}

/// Head and payload of a part, or what is wrong with it.
fn decode(bytes: &[u8]) -> Result<(&[u8], &[u8]), String> {
    let mut reader = Reader::new(bytes);
    if reader.take::<8>() != Some(*MAGIC) {
        return Err("it is no part of a build".into());
    }
    match reader.u32() {
        Some(VERSION) => {}
        Some(other) => return Err(format!("it is of version {other}, and {VERSION} is known")),
        None => return Err("it is cut off".into()),
    }
    let fields = reader.u32().zip(reader.u64()).zip(reader.u32());
    let ((head, payload), stored) = fields.ok_or("it is cut off")?;
    let rest = &bytes[FRONT_BYTES..];
    if rest.len() as u64 != u64::from(head).saturating_add(payload) {
        return Err("it is cut off or damaged; run that step again".into());
    }
    let (head, payload) = rest.split_at(head as usize);
    if checksum(&bytes[..FRONT_BYTES - 4], head, payload) != stored {
        return Err("its checksum is wrong; run that step again".into());
    }
    Ok((head, payload))
}

/// The data of a part, while it is being written.
pub(super) struct DataFile {
    file: OutputFile,
    pub(super) destination: Destination,
}

impl DataFile {
    /// A writer that starts at a byte.
    pub(super) fn writer_at(&self, at: u64) -> Result<rayset_store::output::OutputWriter, BuildError> {
        let mut writer = self.file.writer();
        io::Seek::seek(&mut writer, io::SeekFrom::Start(at)).map_err(|source| self.failed(source))?;
        Ok(writer)
    }

    /// Writes at a byte, from any thread.
    pub(super) fn write_at(&self, bytes: &[u8], at: u64) -> Result<(), BuildError> {
        self.writer_at(at)?.write_all(bytes).map_err(|source| self.failed(source))
    }

    /// The error of a write.
    pub(super) fn failed(&self, source: io::Error) -> BuildError {
        BuildError::Io { action: "write", path: self.destination.path().to_owned(), source }
    }

    /// Gives the file its name.
    pub(super) fn publish(self) -> Result<(), BuildError> {
        Ok(self.file.publish_volatile()?)
    }
}
