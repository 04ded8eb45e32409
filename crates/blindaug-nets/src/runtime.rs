//! Loading and running ONNX files.

use blindaug_io::{Error, Result, guarded, one_line};
use rten_tensor::{AsView, Layout as _, Tensor as RtenTensor};
use std::path::{Path, PathBuf};

/// A tensor of values, whose last axis runs fastest.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor {
    /// The lengths of the axes.
    pub shape: Vec<usize>,
    /// The values, as many as the product of the lengths.
    pub data: Vec<f32>,
}

/// A network that is ready to run.
pub struct Session {
    path: PathBuf,
    runtime: Runtime,
}

enum Runtime {
    Rten(Box<rten::Model>),
    #[cfg(feature = "ort")]
    Ort(std::sync::Mutex<ort::session::Session>),
}

impl Session {
    /// Makes a network of the bytes of an ONNX file; `path` is for messages.
    ///
    /// ONNX Runtime runs the network if the environment variable `ORT_DYLIB_PATH` names its library, else rten does.
    ///
    /// # Errors
    /// If the bytes are cut short or damaged, or the network uses an operator that the runtime lacks.
    pub fn new(path: &Path, onnx: Vec<u8>) -> Result<Self> {
        crate::onnx::check(&onnx).map_err(|e| unusable(path, &e))?;
        #[cfg(feature = "ort")]
        if let Some(library) = std::env::var_os("ORT_DYLIB_PATH").filter(|l| !l.is_empty()) {
            let runtime = guarded(path, || with_ort(path, &library, &onnx))?;
            return Ok(Self { path: path.into(), runtime });
        }
        // rten takes a cubic Resize for a linear one without an error. The file holds the string's length, 5, and the string.
        if onnx.windows(6).any(|w| w == b"\x05cubic") {
            return Err(Error::new(
                path,
                "the network resizes by cubic interpolation, which the built-in runtime lacks: export it with linear one, or set \
                 ORT_DYLIB_PATH to ONNX Runtime's library",
            ));
        }
        let model = deep(path, || rten::Model::load(onnx).map_err(|e| unusable(path, &e)))?;
        Ok(Self { path: path.into(), runtime: Runtime::Rten(Box::new(model)) })
    }

    /// The name of the runtime.
    pub fn runtime(&self) -> &'static str {
        match &self.runtime {
            Runtime::Rten(_) => "rten",
            #[cfg(feature = "ort")]
            Runtime::Ort(_) => "ONNX Runtime",
        }
    }

    /// The names of the inputs, in the order in which [`Session::run`] takes them.
    pub fn inputs(&self) -> Vec<String> {
        match &self.runtime {
            Runtime::Rten(model) => {
                let name = |id: &rten::NodeId| model.node_info(*id)?.name().map(str::to_owned);
                model.input_ids().iter().map(|id| name(id).unwrap_or_default()).collect()
            }
            #[cfg(feature = "ort")]
            Runtime::Ort(session) => lock(session).inputs().iter().map(|i| i.name().to_owned()).collect(),
        }
    }

    /// Runs the network on its inputs, in order, and returns output number `index`, counted from 0.
    ///
    /// # Errors
    /// If the network does not take these inputs, has no such output, or fails.
    pub fn run(&self, inputs: Vec<Tensor>, index: usize) -> Result<Tensor> {
        let shapes = inputs.iter().map(|t| format!("{:?}", t.shape)).collect::<Vec<_>>().join(", ");
        let failed = |e: &dyn std::fmt::Display| {
            let message = one_line(&e.to_string());
            Error::new(
                &self.path,
                format!(
                    "the network does not run on {shapes} ({message}); see that the file is the one that its manifest describes"
                ),
            )
        };
        let no_output = || Error::new(&self.path, format!("the network has no output number {index}"));
        deep(&self.path, || match &self.runtime {
            Runtime::Rten(model) => {
                let ids = model.input_ids();
                if ids.len() != inputs.len() {
                    return Err(failed(&format_args!("it takes {} inputs", ids.len())));
                }
                let output = *model.output_ids().get(index).ok_or_else(no_output)?;
                let inputs = ids
                    .iter()
                    .zip(inputs)
                    .map(|(id, t)| (*id, RtenTensor::from_data(&t.shape, t.data).into()))
                    .collect();
                let mut values = model.run(inputs, &[output], None).map_err(|e| failed(&e))?;
                let tensor = values.pop().and_then(|v| v.into_tensor::<f32>());
                let tensor = tensor.ok_or_else(|| failed(&"its output does not hold floats"))?;
                Ok(Tensor { shape: tensor.shape().to_vec(), data: tensor.to_vec() })
            }
            #[cfg(feature = "ort")]
            Runtime::Ort(session) => {
                let mut session = lock(session);
                let output = session.outputs().get(index).ok_or_else(no_output)?.name().to_owned();
                let values: Vec<ort::session::SessionInputValue> = inputs
                    .into_iter()
                    .map(|t| ort::value::Tensor::from_array((t.shape, t.data)).map(Into::into))
                    .collect::<ort::Result<_>>()
                    .map_err(|e| failed(&e))?;
                let values = session.run(values.as_slice()).map_err(|e| failed(&e))?;
                let (shape, data) =
                    values[output.as_str()].try_extract_tensor::<f32>().map_err(|e| failed(&e))?;
                Ok(Tensor { shape: shape.iter().map(|&n| n as usize).collect(), data: data.to_vec() })
            }
        })
    }
}

/// The size of the stack on which rten plans a network, bytes. It is large because rten follows a chain of operators by recursion.
const STACK: usize = 1 << 28;

/// Runs `run` as [`guarded`] does, in a thread with a large stack.
fn deep<T: Send>(path: &Path, run: impl FnOnce() -> Result<T> + Send) -> Result<T> {
    std::thread::scope(|scope| {
        let thread = std::thread::Builder::new().stack_size(STACK);
        let thread = thread.spawn_scoped(scope, || guarded(path, run));
        let thread = thread.map_err(|e| Error::new(path, format!("no thread can be started ({e})")))?;
        thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })
}

fn unusable(path: &Path, e: &dyn std::fmt::Display) -> Error {
    let message = one_line(&e.to_string());
    Error::new(
        path,
        format!(
            "this is no ONNX network that can be run here ({message}); it may be cut short: install or export it again"
        ),
    )
}

#[cfg(feature = "ort")]
fn with_ort(path: &Path, library: &std::ffi::OsStr, onnx: &[u8]) -> Result<Runtime> {
    use std::sync::OnceLock;
    static ENVIRONMENT: OnceLock<std::result::Result<ort::environment::Environment, String>> =
        OnceLock::new();
    let made = || {
        let builder = ort::init_from(library).map_err(|e| e.to_string())?;
        builder.build().map_err(|e| e.to_string())
    };
    let environment = ENVIRONMENT.get_or_init(made).as_ref().map_err(|e| {
        let message = one_line(e);
        Error::new(
            library,
            format!("ORT_DYLIB_PATH does not name ONNX Runtime's library ({message}); unset it to use the built-in runtime"),
        )
    })?;
    let session = ort::session::Session::builder(environment).and_then(|mut b| b.commit_from_memory(onnx));
    Ok(Runtime::Ort(std::sync::Mutex::new(session.map_err(|e| unusable(path, &e))?)))
}

#[cfg(feature = "ort")]
fn lock(
    session: &std::sync::Mutex<ort::session::Session>,
) -> std::sync::MutexGuard<'_, ort::session::Session> {
    // A run that panicked leaves no state behind that another run would see.
    session.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}
