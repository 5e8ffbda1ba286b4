//! The C interface, as `palpate_touch.h` declares it.
//!
//! Scenes and batches are numbers, so that one that is closed or was never opened is an error and no crash. Every function
//! returns 0 or a code; [`palpate_touch_last_error`] has the message of the last error of the calling thread. No panic
//! leaves a function.

#![expect(unsafe_code, reason = "callers hand over pointers")]

use std::any::Any;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::ffi::{CStr, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::slice;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::{FixedBody, TouchBatch, TouchError, TouchScene};

/// Version of this interface; it changes whenever a caller of an older one could go wrong.
pub const ABI_VERSION: u32 = 1;

/// Code of [`TouchError::Argument`].
pub const BAD_ARGUMENT: i32 = 1;
/// Code of [`TouchError::File`].
pub const BAD_FILE: i32 = 2;
/// Code of [`TouchError::Input`].
pub const BAD_INPUT: i32 = 3;
/// Code of a panic: a mistake in this library.
pub const BUG: i32 = 4;

/// What is open, by handle.
#[derive(Clone)]
enum Opened {
    Scene(Arc<TouchScene>),
    Batch(Arc<Mutex<TouchBatch>>),
}

/// Handles begin at 1 and are never given twice.
struct Handles {
    last: u64,
    opened: BTreeMap<u64, Opened>,
}

static HANDLES: Mutex<Handles> = Mutex::new(Handles { last: 0, opened: BTreeMap::new() });

thread_local! {
    static LAST_ERROR: RefCell<String> = const { RefCell::new(String::new()) };
}

fn handles() -> MutexGuard<'static, Handles> {
    HANDLES.lock().unwrap_or_else(PoisonError::into_inner)
}

fn open(opened: Opened) -> u64 {
    let mut handles = handles();
    handles.last += 1;
    let handle = handles.last;
    handles.opened.insert(handle, opened);
    handle
}

fn scene_of(handle: u64) -> Result<Arc<TouchScene>, TouchError> {
    match handles().opened.get(&handle) {
        Some(Opened::Scene(scene)) => Ok(Arc::clone(scene)),
        _ => Err(TouchError::Argument(format!("{handle} is no open scene"))),
    }
}

fn batch_of(handle: u64) -> Result<Arc<Mutex<TouchBatch>>, TouchError> {
    match handles().opened.get(&handle) {
        Some(Opened::Batch(batch)) => Ok(Arc::clone(batch)),
        _ => Err(TouchError::Argument(format!("{handle} is no open batch"))),
    }
}

/// Carries `work` out and turns what goes wrong into a code and the thread's message.
fn guarded(work: impl FnOnce() -> Result<(), TouchError>) -> i32 {
    let (code, message) = match catch_unwind(AssertUnwindSafe(work)) {
        Ok(Ok(())) => return 0,
        Ok(Err(error)) => {
            let code = match error {
                TouchError::Argument(_) => BAD_ARGUMENT,
                TouchError::File(_) => BAD_FILE,
                TouchError::Input(_) => BAD_INPUT,
            };
            (code, error.to_string())
        }
        Err(panic) => (BUG, format!("a mistake in palpate_touch: {}", panic_text(&*panic))),
    };
    LAST_ERROR.with_borrow_mut(|last| *last = message);
    code
}

fn panic_text(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("a panic without a message")
}

fn null(name: &str) -> TouchError {
    TouchError::Argument(format!("{name} is a null pointer"))
}

/// # Safety
/// `text` is null or ends with a zero, and stays as it is for `'a`.
unsafe fn text<'a>(name: &str, text: *const c_char) -> Result<&'a str, TouchError> {
    if text.is_null() {
        return Err(null(name));
    }
    // SAFETY: the caller's promise.
    let text = unsafe { CStr::from_ptr(text) };
    text.to_str().map_err(|err| TouchError::Argument(format!("{name} is not UTF-8: {err}")))
}

/// # Safety
/// `values` is null or points to `len` values that nobody changes for `'a`.
unsafe fn input<'a, T>(name: &str, values: *const T, len: usize) -> Result<&'a [T], TouchError> {
    match (values.is_null(), len) {
        (_, 0) => Ok(&[]),
        (true, _) => Err(null(name)),
        // SAFETY: the caller's promise.
        (false, _) => Ok(unsafe { slice::from_raw_parts(values, len) }),
    }
}

/// # Safety
/// `values` is null or points to `len` values that nobody else touches for `'a`.
unsafe fn output<'a, T>(name: &str, values: *mut T, len: usize) -> Result<&'a mut [T], TouchError> {
    match (values.is_null(), len) {
        (_, 0) => Ok(&mut []),
        (true, _) => Err(null(name)),
        // SAFETY: the caller's promise.
        (false, _) => Ok(unsafe { slice::from_raw_parts_mut(values, len) }),
    }
}

/// Copies as much of `text` as has room in `buffer`, and its whole length into `length`.
///
/// # Safety
/// As for [`output`], of `capacity` bytes and of one number.
unsafe fn copy_out(
    text: &str,
    buffer: *mut c_char,
    capacity: usize,
    length: *mut usize,
) -> Result<(), TouchError> {
    // SAFETY: the caller's promise.
    let (buffer, length) =
        unsafe { (output("buffer", buffer.cast::<u8>(), capacity)?, output("length", length, 1)?) };
    let num_bytes = text.len().min(capacity);
    buffer[..num_bytes].copy_from_slice(&text.as_bytes()[..num_bytes]);
    length[0] = text.len();
    Ok(())
}

/// [`ABI_VERSION`], which a caller compares with the one that it was written for.
#[unsafe(no_mangle)]
pub extern "C" fn palpate_touch_abi_version() -> u32 {
    ABI_VERSION
}

/// Copies the message of the calling thread's last error, as much as has room in `capacity` bytes of `buffer`, and gives its
/// whole length. There is no zero at its end.
///
/// # Safety
/// `buffer` points to `capacity` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn palpate_touch_last_error(buffer: *mut c_char, capacity: usize) -> usize {
    let mut length = 0;
    LAST_ERROR.with_borrow(|last| {
        // SAFETY: the caller's promise. A null buffer leaves the length at 0.
        let _ = unsafe { copy_out(last, buffer, capacity, &raw mut length) };
    });
    length
}

/// Opens a scene ([`TouchScene::open`]): `model_text` may be null for the station's nominal model; `fixed_objects` are
/// `num_fixed` texts, `fixed_poses` 7 numbers for each.
///
/// # Safety
/// Texts end with a zero, the others point to as many values as they say.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn palpate_touch_open(
    station: *const c_char,
    model_name: *const c_char,
    model_text: *const c_char,
    object: *const c_char,
    num_fixed: usize,
    fixed_objects: *const *const c_char,
    fixed_poses: *const [f64; 7],
    scene: *mut u64,
) -> i32 {
    guarded(|| {
        // SAFETY: the caller's promise.
        unsafe {
            let handle = output("scene", scene, 1)?;
            let model = if model_text.is_null() {
                None
            } else {
                Some((text("model_name", model_name)?, text("model_text", model_text)?))
            };
            let objects = input("fixed_objects", fixed_objects, num_fixed)?;
            let poses = input("fixed_poses", fixed_poses, num_fixed)?;
            let fixed = objects
                .iter()
                .zip(poses)
                .map(|(object, pose)| {
                    Ok(FixedBody { object: text("fixed_objects", *object)?, base_from_body: *pose })
                })
                .collect::<Result<Vec<_>, TouchError>>()?;
            let opened = TouchScene::open(text("station", station)?, model, text("object", object)?, &fixed)?;
            handle[0] = open(Opened::Scene(Arc::new(opened)));
        }
        Ok(())
    })
}

/// Copies what a scene is made of, as JSON: by name, or with all numbers ([`TouchScene::names_json`],
/// [`TouchScene::numbers_json`]).
///
/// # Safety
/// `buffer` points to `capacity` bytes, `length` to a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn palpate_touch_describe(
    scene: u64,
    with_numbers: i32,
    buffer: *mut c_char,
    capacity: usize,
    length: *mut usize,
) -> i32 {
    guarded(|| {
        let scene = scene_of(scene)?;
        let json = if with_numbers == 0 { scene.names_json() } else { scene.numbers_json() };
        // SAFETY: the caller's promise.
        unsafe { copy_out(&json, buffer, capacity, length) }
    })
}

/// Readings of a whole take ([`TouchScene::replay`]): `positions` is frames x joints, `raw` and `active` frames x channels.
///
/// # Safety
/// All point to as many values.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn palpate_touch_replay(
    scene: u64,
    num_frames: usize,
    times_s: *const f64,
    positions: *const f64,
    base_from_object: *const [f64; 7],
    raw: *mut f64,
    active: *mut u8,
) -> i32 {
    guarded(|| {
        let scene = scene_of(scene)?;
        let station = scene.station();
        let num_values = values_of(num_frames, station.robot.num_dofs())?;
        let num_readings = values_of(num_frames, station.layout.num_channels())?;
        // SAFETY: the caller's promise.
        let (times_s, positions, pose, raw, active) = unsafe {
            (
                input("times_s", times_s, num_frames)?,
                input("positions", positions, num_values)?,
                input("base_from_object", base_from_object, 1)?,
                output("raw", raw, num_readings)?,
                output("active", active, num_readings)?,
            )
        };
        let readings = scene.replay(times_s, positions, &pose[0])?;
        raw.copy_from_slice(&readings.raw);
        active.iter_mut().zip(readings.active).for_each(|(to, from)| *to = u8::from(from));
        Ok(())
    })
}

/// Opens a batch of environments of a scene ([`TouchBatch::new`]). The scene may be closed while batches of it are open.
///
/// # Safety
/// `batch` points to a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn palpate_touch_batch(
    scene: u64,
    num_envs: usize,
    num_threads: usize,
    batch: *mut u64,
) -> i32 {
    guarded(|| {
        // SAFETY: the caller's promise.
        let handle = unsafe { output("batch", batch, 1)? };
        let opened = TouchBatch::new(scene_of(scene)?, num_envs, num_threads)?;
        handle[0] = open(Opened::Batch(Arc::new(Mutex::new(opened))));
        Ok(())
    })
}

/// One frame of every environment ([`TouchBatch::step`]): `positions` is environments x joints, `poses` environments x 7,
/// `raw` and `active` environments x channels.
///
/// # Safety
/// All point to as many values.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn palpate_touch_step(
    batch: u64,
    times_s: *const f64,
    positions: *const f64,
    poses: *const [f64; 7],
    raw: *mut f64,
    active: *mut u8,
) -> i32 {
    guarded(|| {
        let batch = batch_of(batch)?;
        let mut batch = batch.lock().unwrap_or_else(PoisonError::into_inner);
        let num_envs = batch.num_envs();
        let station = batch.scene().station();
        let num_values = values_of(num_envs, station.robot.num_dofs())?;
        let num_readings = values_of(num_envs, station.layout.num_channels())?;
        // SAFETY: the caller's promise.
        let (times_s, positions, poses, raw, active) = unsafe {
            (
                input("times_s", times_s, num_envs)?,
                input("positions", positions, num_values)?,
                input("poses", poses, num_envs)?,
                output("raw", raw, num_readings)?,
                output("active", active, num_readings)?,
            )
        };
        batch.step(times_s, positions, poses, raw, active)
    })
}

/// A new episode begins ([`TouchBatch::restart`]) where `which`, a byte for each environment, is not 0; null: everywhere.
///
/// # Safety
/// `which` is null or points to as many bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn palpate_touch_restart(batch: u64, which: *const u8) -> i32 {
    guarded(|| {
        let batch = batch_of(batch)?;
        let mut batch = batch.lock().unwrap_or_else(PoisonError::into_inner);
        let num_envs = batch.num_envs();
        // SAFETY: the caller's promise.
        let which = if which.is_null() { None } else { Some(unsafe { input("which", which, num_envs)? }) };
        batch.restart(which);
        Ok(())
    })
}

/// Closes a scene or a batch.
#[unsafe(no_mangle)]
pub extern "C" fn palpate_touch_close(handle: u64) -> i32 {
    guarded(|| {
        let closed = handles().opened.remove(&handle);
        closed.map(drop).ok_or_else(|| TouchError::Argument(format!("{handle} is nothing that is open")))
    })
}

fn values_of(rows: usize, columns: usize) -> Result<usize, TouchError> {
    rows.checked_mul(columns)
        .ok_or_else(|| TouchError::Input(format!("{rows} rows of {columns} values are too many")))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn last_error() -> String {
        // SAFETY: the buffers are as long as they say.
        unsafe {
            let mut bytes = vec![0_u8; palpate_touch_last_error(std::ptr::dangling_mut::<c_char>(), 0)];
            palpate_touch_last_error(bytes.as_mut_ptr().cast(), bytes.len());
            String::from_utf8(bytes).expect("UTF-8")
        }
    }

    #[test]
    fn a_panic_becomes_a_code_and_a_message() {
        assert_eq!(guarded(|| panic!("thumb {}", 3)), BUG);
        assert_eq!(last_error(), "a mistake in palpate_touch: thumb 3");
        assert_eq!(guarded(|| Ok(())), 0);
    }

    #[test]
    fn handles_that_are_not_open_and_null_pointers_are_errors() {
        // SAFETY: nothing is read of null pointers.
        unsafe {
            assert_eq!(palpate_touch_restart(0, std::ptr::null()), BAD_ARGUMENT);
            assert_eq!(last_error(), "0 is no open batch");
            let mut batch = 0;
            assert_eq!(palpate_touch_batch(u64::MAX, 1, 1, &raw mut batch), BAD_ARGUMENT);
            assert!(last_error().contains("no open scene"), "{}", last_error());
            let none = std::ptr::null();
            let mut scene = 0;
            let code = palpate_touch_open(
                none,
                none,
                none,
                none,
                0,
                std::ptr::null(),
                std::ptr::null(),
                &raw mut scene,
            );
            assert_eq!((code, last_error().as_str()), (BAD_ARGUMENT, "station is a null pointer"));
            let code = palpate_touch_batch(1, 1, 1, std::ptr::null_mut());
            assert_eq!((code, last_error().as_str()), (BAD_ARGUMENT, "batch is a null pointer"));
        }
        assert_eq!(palpate_touch_close(0), BAD_ARGUMENT);
    }
}
