//! A training, or what came out of it, as bytes: a safetensors file that other programs read as well.
//!
//! Everything that is no tensor is JSON under the key `state` of the file's metadata. Each tensor has its checksum there,
//! and the JSON its own in the tensor `state.crc32`, because a bit that flips in a weight would otherwise go unnoticed.

use std::{
    collections::{BTreeMap, HashMap},
    path::{Path, PathBuf},
};

use half::f16;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::{Array, TrainingError};

const STATE_KEY: &str = "state";
const STATE_CHECKSUM: &str = "state.crc32";

/// Bytes of a tensor on their way into a file.
#[derive(Clone, Debug)]
pub struct Encoded {
    name: String,
    dtype: Dtype,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

impl Encoded {
    /// Numbers with all their bits.
    pub fn floats(name: String, shape: [usize; 2], values: &[f32]) -> Self {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        Self { name, dtype: Dtype::F32, shape: shape.to_vec(), bytes }
    }

    /// Each number as the nearest of 16 bits.
    ///
    /// # Errors
    /// A number too large for that: says which in which array.
    pub fn halves(array: &Array) -> Result<Self, String> {
        let Array { name, shape, values } = array;
        if let Some(value) = values.iter().find(|&&value| !f16::from_f32(value).is_finite()) {
            return Err(format!("{name} holds {value}, expected at most {} for 16 bits", f16::MAX));
        }
        let bytes = values.iter().flat_map(|&value| f16::from_f32(value).to_le_bytes()).collect();
        Ok(Self { name: name.clone(), dtype: Dtype::F16, shape: shape.to_vec(), bytes })
    }

    /// Numbers of 64 bits.
    pub fn doubles(name: String, values: &[f64]) -> Self {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        Self { name, dtype: Dtype::F64, shape: vec![values.len()], bytes }
    }

    /// The bytes of another file, as they are.
    pub fn file(name: String, bytes: &[u8]) -> Self {
        Self { name, dtype: Dtype::U8, shape: vec![bytes.len()], bytes: bytes.to_vec() }
    }
}

/// The file of `tensors` and of the state that `state` makes of their checksums, which it has to hold as `checksums`.
pub fn encode<S: Serialize>(
    mut tensors: Vec<Encoded>,
    state: impl FnOnce(BTreeMap<String, u32>) -> S,
) -> Vec<u8> {
    let checksum = |tensor: &Encoded| (tensor.name.clone(), crc32fast::hash(&tensor.bytes));
    let state = state(tensors.iter().map(checksum).collect());
    let state = serde_json::to_string(&state).expect("numbers and names are JSON");
    tensors.push(Encoded {
        name: STATE_CHECKSUM.to_owned(),
        dtype: Dtype::U32,
        shape: vec![1],
        bytes: crc32fast::hash(state.as_bytes()).to_le_bytes().to_vec(),
    });
    let views = tensors.iter().map(|tensor| {
        let view = TensorView::new(tensor.dtype, tensor.shape.clone(), &tensor.bytes);
        (tensor.name.as_str(), view.expect("as many bytes as the shape says"))
    });
    let metadata = HashMap::from([(STATE_KEY.to_owned(), state)]);
    safetensors::serialize(views, Some(metadata)).expect("every name is given once")
}

/// A file whose state has been read.
#[derive(Debug)]
pub struct TensorFile<'a, S> {
    path: PathBuf,
    tensors: SafeTensors<'a>,
    checksums: BTreeMap<String, u32>,
    /// Everything that is no tensor.
    pub state: S,
}

/// What every version of a state says first.
#[derive(Deserialize)]
struct Format {
    format: u32,
}

#[derive(Deserialize)]
struct Checksums {
    checksums: BTreeMap<String, u32>,
}

impl<'a, S: DeserializeOwned> TensorFile<'a, S> {
    /// The file that `bytes` are, whose state has this `format`. `path` names it in errors.
    ///
    /// # Errors
    /// Files that are cut off, whose state was altered, or of another format.
    pub fn open(path: &Path, bytes: &'a [u8], format: u32) -> Result<Self, TrainingError> {
        let error = |problem: String| TrainingError::Checkpoint { path: path.to_owned(), problem };
        let no_tensors = |err| error(format!("not a whole safetensors file: {err}"));
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(no_tensors)?;
        let tensors = SafeTensors::deserialize(bytes).map_err(no_tensors)?;
        let state = header
            .metadata()
            .as_ref()
            .and_then(|metadata| metadata.get(STATE_KEY))
            .ok_or_else(|| error(format!("its metadata has no {STATE_KEY:?}: it holds no training")))?;
        let checksum = tensors.tensor(STATE_CHECKSUM).ok().map(|view| view.data().to_vec());
        if checksum.as_deref() != Some(&crc32fast::hash(state.as_bytes()).to_le_bytes()) {
            return Err(error(format!("{STATE_KEY} does not match {STATE_CHECKSUM}: the file was altered")));
        }
        let unreadable = |err| error(format!("{STATE_KEY}: {err}"));
        let Format { format: found } = serde_json::from_str(state).map_err(unreadable)?;
        if found != format {
            return Err(error(format!("format is {found}, expected {format}")));
        }
        let Checksums { checksums } = serde_json::from_str(state).map_err(unreadable)?;
        let state = serde_json::from_str(state).map_err(unreadable)?;
        Ok(Self { path: path.to_owned(), tensors, checksums, state })
    }

    /// A problem with this file.
    pub fn error(&self, problem: String) -> TrainingError {
        TrainingError::Checkpoint { path: self.path.clone(), problem }
    }

    /// The tensor called `name`.
    ///
    /// # Errors
    /// No such tensor, another type or shape, another checksum, numbers that are none; so for all below.
    pub fn floats(&self, name: &str, shape: [usize; 2]) -> Result<Vec<f32>, TrainingError> {
        let numbers = self.bytes(name, Dtype::F32, &shape)?.as_chunks().0.iter();
        let values: Vec<f32> = numbers.map(|bytes| f32::from_le_bytes(*bytes)).collect();
        self.finite(name, values.iter().all(|value| value.is_finite()))?;
        Ok(values)
    }

    /// The tensor called `name`, which has 16 bits.
    ///
    /// # Errors
    /// See [`TensorFile::floats`].
    pub fn halves(&self, name: &str, shape: [usize; 2]) -> Result<Vec<f32>, TrainingError> {
        let numbers = self.bytes(name, Dtype::F16, &shape)?.as_chunks().0.iter();
        let values: Vec<f32> = numbers.map(|bytes| f16::from_le_bytes(*bytes).to_f32()).collect();
        self.finite(name, values.iter().all(|value| value.is_finite()))?;
        Ok(values)
    }

    /// The tensor called `name`, which has 64 bits.
    ///
    /// # Errors
    /// See [`TensorFile::floats`].
    pub fn doubles(&self, name: &str, len: usize) -> Result<Vec<f64>, TrainingError> {
        let numbers = self.bytes(name, Dtype::F64, &[len])?.as_chunks().0.iter();
        let values: Vec<f64> = numbers.map(|bytes| f64::from_le_bytes(*bytes)).collect();
        self.finite(name, values.iter().all(|value| value.is_finite()))?;
        Ok(values)
    }

    /// The bytes of the file in the tensor called `name`, however many there are.
    ///
    /// # Errors
    /// See [`TensorFile::floats`].
    pub fn file(&self, name: &str) -> Result<Vec<u8>, TrainingError> {
        let len: usize = self.view(name)?.shape().iter().product();
        Ok(self.bytes(name, Dtype::U8, &[len])?.to_vec())
    }

    fn view(&self, name: &str) -> Result<TensorView<'a>, TrainingError> {
        self.tensors.tensor(name).map_err(|_| self.error(format!("it has no tensor {name}")))
    }

    fn bytes(&self, name: &str, dtype: Dtype, shape: &[usize]) -> Result<&[u8], TrainingError> {
        let view = self.view(name)?;
        if view.dtype() != dtype || view.shape() != shape {
            return Err(self.error(format!(
                "tensor {name} is {:?} {:?}, expected {dtype:?} {shape:?}",
                view.dtype(),
                view.shape()
            )));
        }
        if self.checksums.get(name) != Some(&crc32fast::hash(view.data())) {
            return Err(
                self.error(format!("tensor {name} does not match its checksum: the file was altered"))
            );
        }
        Ok(view.data())
    }

    fn finite(&self, name: &str, holds: bool) -> Result<(), TrainingError> {
        if holds { Ok(()) } else { Err(self.error(format!("tensor {name} holds numbers that are none"))) }
    }
}
