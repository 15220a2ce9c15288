//! Embree 4, loaded at run time: nothing is linked with it. `scripts/fetch-embree.sh` fetches the library.
//!
//! The declarations are those of `rtcore_ray.h`, `rtcore_scene.h` and `rtcore_common.h` of Embree 4.4.

#![allow(unsafe_code, reason = "a C interface")]

mod rays;

use std::ffi::{CStr, c_char, c_int, c_uint, c_void};
use std::path::{Path, PathBuf};
use std::ptr::null_mut;

use glam::Vec3;
use libloading::Library;
use ropewalk::device::layout;

use crate::Result;
use rays::{Ray, Ray16, RayHit, RayHit16, Valid};

type Pointer = *mut c_void;

/// The functions used, by name and type.
macro_rules! functions {
    ($($name:ident($($argument:ty),*) $(-> $result:ty)?;)*) => {
        #[allow(non_snake_case)]
        struct Functions { $($name: unsafe extern "C" fn($($argument),*) $(-> $result)?),* }

        impl Functions {
            fn load(library: &Library) -> Result<Self> {
                // SAFETY: the types are those of the headers.
                unsafe { Ok(Self { $($name: *library.get(concat!(stringify!($name), "\0").as_bytes())?),* }) }
            }
        }
    };
}

functions! {
    rtcNewDevice(*const c_char) -> Pointer;
    rtcReleaseDevice(Pointer);
    rtcGetDeviceError(Pointer) -> c_uint;
    rtcGetDeviceLastErrorMessage(Pointer) -> *const c_char;
    rtcNewScene(Pointer) -> Pointer;
    rtcReleaseScene(Pointer);
    rtcSetSceneBuildQuality(Pointer, c_uint);
    rtcSetSceneFlags(Pointer, c_uint);
    rtcCommitScene(Pointer);
    rtcNewGeometry(Pointer, c_uint) -> Pointer;
    rtcReleaseGeometry(Pointer);
    rtcSetNewGeometryBuffer(Pointer, c_uint, c_uint, c_uint, usize, usize) -> Pointer;
    rtcCommitGeometry(Pointer);
    rtcAttachGeometry(Pointer, Pointer) -> c_uint;
    rtcIntersect1(Pointer, *mut RayHit, *mut Arguments);
    rtcIntersect16(*const c_int, Pointer, *mut RayHit16, *mut Arguments);
    rtcOccluded1(Pointer, *mut Ray, *mut Arguments);
    rtcOccluded16(*const c_int, Pointer, *mut Ray16, *mut Arguments);
}

const GEOMETRY_TYPE_TRIANGLE: c_uint = 0;
const BUFFER_TYPE_INDEX: c_uint = 0;
const BUFFER_TYPE_VERTEX: c_uint = 1;
const FORMAT_UINT3: c_uint = 0x5003;
const FORMAT_FLOAT3: c_uint = 0x9003;
const SCENE_FLAG_ROBUST: c_uint = 1 << 2;
const RAY_QUERY_FLAG_COHERENT: c_uint = 1 << 16;
const FEATURE_FLAG_ALL: c_uint = c_uint::MAX;

/// `RTCIntersectArguments` and `RTCOccludedArguments`, which differ in a callback's type only.
#[repr(C)]
struct Arguments {
    flags: c_uint,
    feature_mask: c_uint,
    context: Pointer,
    filter: Pointer,
    callback: Pointer,
}

impl Arguments {
    fn new(is_coherent: bool) -> Self {
        let flags = if is_coherent { RAY_QUERY_FLAG_COHERENT } else { 0 };
        Self { flags, feature_mask: FEATURE_FLAG_ALL, context: null_mut(), filter: null_mut(), callback: null_mut() }
    }
}

/// How good a hierarchy, `RTCBuildQuality`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Quality {
    /// Morton codes.
    Low = 0,
    /// Binned SAH: the default.
    Medium = 1,
    /// Spatial splits.
    High = 2,
}

/// The library and a device of it.
pub struct Embree {
    functions: Functions,
    device: Pointer,
}

impl Embree {
    /// Loads the library from the folder `ROPEWALK_EMBREE`, or from `target/embree`. Scenes are built on so many
    /// threads; 0 for all. Rays are traced on the thread that calls.
    ///
    /// # Errors
    /// There is none, and how to fetch it.
    pub fn open(threads: usize) -> Result<Self> {
        let default = concat!(env!("CARGO_MANIFEST_DIR"), "/../target/embree");
        let folder = PathBuf::from(std::env::var_os("ROPEWALK_EMBREE").unwrap_or_else(|| default.into()));
        let load = |prefix| -> Result<Library> {
            // SAFETY: both libraries do nothing but set themselves up.
            Ok(unsafe { Library::new(find(&folder, prefix)?)? })
        };
        // Embree finds its threads by the library's name: they are to be in memory before.
        let tbb = load("libtbb")?;
        let embree = load("libembree4")?;
        let functions = Functions::load(&embree)?;
        let config = format!("threads={threads}\0");
        // SAFETY: the string ends in a zero.
        let device = unsafe { (functions.rtcNewDevice)(config.as_ptr().cast()) };
        if device.is_null() {
            // SAFETY: asks for the error of the call before, which had no device.
            let error = unsafe { (functions.rtcGetDeviceError)(null_mut()) };
            return Err(format!("Embree gives no device: error {error}").into());
        }
        // Their threads outlive the device: they stay in memory.
        std::mem::forget([embree, tbb]);
        Ok(Self { functions, device })
    }

    /// Builds a scene of one geometry.
    ///
    /// # Errors
    /// Embree's error.
    pub fn scene(&self, triangles: &[[Vec3; 3]], quality: Quality, robust: bool) -> Result<Scene<'_>> {
        let f = &self.functions;
        let count = triangles.len();
        // SAFETY: as the manual has it. Buffers hold as many elements as asked for; handles are released once.
        let scene = unsafe {
            let scene = Scene { embree: self, scene: (f.rtcNewScene)(self.device) };
            (f.rtcSetSceneBuildQuality)(scene.scene, quality as c_uint);
            (f.rtcSetSceneFlags)(scene.scene, if robust { SCENE_FLAG_ROBUST } else { 0 });
            let geometry = (f.rtcNewGeometry)(self.device, GEOMETRY_TYPE_TRIANGLE);
            let buffer = |kind, format, count| {
                let buffer = (f.rtcSetNewGeometryBuffer)(geometry, kind, 0, format, 12, count);
                self.check().map(|()| buffer)
            };
            let corners = buffer(BUFFER_TYPE_VERTEX, FORMAT_FLOAT3, 3 * count)?;
            corners.cast::<[Vec3; 3]>().copy_from_nonoverlapping(triangles.as_ptr(), count);
            let indices = buffer(BUFFER_TYPE_INDEX, FORMAT_UINT3, count)?.cast::<[u32; 3]>();
            for i in 0..count as u32 {
                indices.add(i as usize).write([3 * i, 3 * i + 1, 3 * i + 2]);
            }
            (f.rtcCommitGeometry)(geometry);
            (f.rtcAttachGeometry)(scene.scene, geometry);
            (f.rtcReleaseGeometry)(geometry);
            (f.rtcCommitScene)(scene.scene);
            scene
        };
        self.check()?;
        Ok(scene)
    }

    /// The error since the last call, if there was one.
    fn check(&self) -> Result<()> {
        // SAFETY: the device lives; the message does until the next error.
        let (error, message) = unsafe {
            let error = (self.functions.rtcGetDeviceError)(self.device);
            (error, (self.functions.rtcGetDeviceLastErrorMessage)(self.device))
        };
        if error == 0 {
            return Ok(());
        }
        // SAFETY: as above, where there is one.
        let message = if message.is_null() { "" } else { unsafe { CStr::from_ptr(message) }.to_str().unwrap_or("") };
        Err(format!("Embree: error {error}: {message}").into())
    }
}

impl Drop for Embree {
    fn drop(&mut self) {
        // SAFETY: scenes borrow the device, so there are none left.
        unsafe { (self.functions.rtcReleaseDevice)(self.device) }
    }
}

/// The file in `folder` that starts with `prefix`: wheels add a checksum to the name.
fn find(folder: &Path, prefix: &str) -> Result<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut paths = entries.map(|entry| entry.path());
    let found = paths.find(|path| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(prefix)));
    let advice = "run scripts/fetch-embree.sh, or set ROPEWALK_EMBREE to the folder of the libraries";
    found.ok_or_else(|| format!("no {prefix}* in {}: {advice}", folder.display()).into())
}

/// A scene built.
pub struct Scene<'a> {
    embree: &'a Embree,
    scene: Pointer,
}

// SAFETY: Embree allows any number of threads to trace a scene that is committed, which a `Scene` is.
unsafe impl Sync for Scene<'_> {}

impl Drop for Scene<'_> {
    fn drop(&mut self) {
        // SAFETY: it was made in one place and is released in this one.
        unsafe { (self.embree.functions.rtcReleaseScene)(self.scene) }
    }
}

/// Rays as Embree takes them and answers in them: to be traced, read, and written anew.
pub trait Batch {
    /// Takes over rays that have not been traced.
    fn write(&mut self, rays: &[layout::RayRecord]);

    /// Traces them.
    fn trace(&mut self, scene: &Scene<'_>, is_coherent: bool);

    /// What the last trace found, as [`closest_answer`](crate::rays::closest_answer) and
    /// [`any_answer`](crate::rays::any_answer) have it.
    fn answers(&self) -> Vec<f32>;
}

/// For `rtcIntersect1`.
#[derive(Debug, Default)]
pub struct Closest1(Vec<RayHit>);

impl Closest1 {
    /// The triangle that each ray of the last trace has hit, and where.
    pub fn hits(&self) -> impl Iterator<Item = Option<(u32, f32)>> {
        self.0.iter().map(RayHit::hit)
    }
}

/// For `rtcIntersect16`.
#[derive(Debug, Default)]
pub struct Closest16(Vec<(Valid, RayHit16)>);

/// For `rtcOccluded1`.
#[derive(Debug, Default)]
pub struct Any1(Vec<Ray>);

/// For `rtcOccluded16`.
#[derive(Debug, Default)]
pub struct Any16(Vec<(Valid, Ray16)>);

impl Batch for Closest1 {
    fn write(&mut self, rays: &[layout::RayRecord]) {
        self.0.clear();
        self.0.extend(rays.iter().map(|ray| RayHit::from(Ray::from(ray))));
    }

    fn trace(&mut self, scene: &Scene<'_>, is_coherent: bool) {
        let mut arguments = Arguments::new(is_coherent);
        for ray in &mut self.0 {
            // SAFETY: all three live throughout the call, the ray is aligned.
            unsafe { (scene.embree.functions.rtcIntersect1)(scene.scene, ray, &mut arguments) }
        }
    }

    fn answers(&self) -> Vec<f32> {
        self.0.iter().map(RayHit::answer).collect()
    }
}

impl Batch for Closest16 {
    fn write(&mut self, rays: &[layout::RayRecord]) {
        self.0.clear();
        self.0.extend(rays.chunks(16).map(|rays| (Valid::new(rays.len()), RayHit16::from(Ray16::from(rays)))));
    }

    fn trace(&mut self, scene: &Scene<'_>, is_coherent: bool) {
        let mut arguments = Arguments::new(is_coherent);
        for (valid, rays) in &mut self.0 {
            // SAFETY: as above.
            unsafe {
                (scene.embree.functions.rtcIntersect16)(valid.as_ptr(), scene.scene, rays, &mut arguments);
            }
        }
    }

    fn answers(&self) -> Vec<f32> {
        self.0.iter().flat_map(|(valid, hits)| valid.of(hits.answers())).collect()
    }
}

impl Batch for Any1 {
    fn write(&mut self, rays: &[layout::RayRecord]) {
        self.0.clear();
        self.0.extend(rays.iter().map(Ray::from));
    }

    fn trace(&mut self, scene: &Scene<'_>, is_coherent: bool) {
        let mut arguments = Arguments::new(is_coherent);
        for ray in &mut self.0 {
            // SAFETY: as above.
            unsafe { (scene.embree.functions.rtcOccluded1)(scene.scene, ray, &mut arguments) }
        }
    }

    fn answers(&self) -> Vec<f32> {
        self.0.iter().map(Ray::answer).collect()
    }
}

impl Batch for Any16 {
    fn write(&mut self, rays: &[layout::RayRecord]) {
        self.0.clear();
        self.0.extend(rays.chunks(16).map(|rays| (Valid::new(rays.len()), Ray16::from(rays))));
    }

    fn trace(&mut self, scene: &Scene<'_>, is_coherent: bool) {
        let mut arguments = Arguments::new(is_coherent);
        for (valid, rays) in &mut self.0 {
            // SAFETY: as above.
            unsafe {
                (scene.embree.functions.rtcOccluded16)(valid.as_ptr(), scene.scene, rays, &mut arguments);
            }
        }
    }

    fn answers(&self) -> Vec<f32> {
        self.0.iter().flat_map(|(valid, rays)| valid.of(rays.answers())).collect()
    }
}
