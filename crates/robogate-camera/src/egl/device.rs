//! An OpenGL context without a window, on the first EGL device that supports OpenGL.

use std::env;
use std::ffi::{CStr, c_char, c_uint, c_void};

use khronos_egl as egl;

/// Environment variable with the index of the device, as in MuJoCo's Python package. Without it the first working
/// device is used.
const DEVICE_VARIABLE: &str = "MUJOCO_EGL_DEVICE_ID";

/// `EGL_PLATFORM_DEVICE_EXT` (EGL_EXT_platform_device).
const PLATFORM_DEVICE: egl::Enum = 0x313F;
/// `EGL_PLATFORM_SURFACELESS_MESA` (EGL_MESA_platform_surfaceless).
const PLATFORM_SURFACELESS: egl::Enum = 0x31DD;

/// `GL_RENDERER`, `GL_VERSION` and `GL_EXTENSIONS`.
const RENDERER: c_uint = 0x1F01;
const VERSION: c_uint = 0x1F02;
const EXTENSIONS: c_uint = 0x1F03;

/// MuJoCo ends the process without these extensions.
const NEEDED: [&str; 2] = ["GL_ARB_framebuffer_object", "GL_ARB_vertex_buffer_object"];

type QueryDevices = unsafe extern "system" fn(egl::Int, *mut *mut c_void, *mut egl::Int) -> egl::Boolean;
type GetString = unsafe extern "system" fn(c_uint) -> *const c_char;

/// EGL and an OpenGL context.
pub(crate) struct Gl {
    egl: egl::DynamicInstance<egl::EGL1_5>,
    display: egl::Display,
    context: egl::Context,
    surface: egl::Surface,
    name: String,
}

impl Gl {
    /// A context on the first device that supports OpenGL.
    #[expect(clippy::disallowed_methods, reason = "EGL and its users choose the device by environment variables")]
    pub(crate) fn new() -> Result<Self, String> {
        if env::var("MUJOCO_GL").is_ok_and(|wanted| wanted == "osmesa") {
            return Err("MUJOCO_GL=osmesa selects another library. Unset it to use EGL".to_owned());
        }
        // SAFETY: the system's EGL library implements EGL.
        #[expect(unsafe_code, reason = "a library is loaded")]
        let egl = unsafe { egl::DynamicInstance::<egl::EGL1_5>::load_required() }.map_err(|error| {
            format!(
                "cannot load EGL 1.5: {error}\nHint: on Debian and Ubuntu: apt-get install libegl1 libgl1 libgl1-mesa-dri"
            )
        })?;
        let wanted = match env::var(DEVICE_VARIABLE) {
            Ok(number) if !number.is_empty() => Some(
                number
                    .parse::<usize>()
                    .map_err(|_| format!("{DEVICE_VARIABLE}={number}: expected the index of a device"))?,
            ),
            _ => None,
        };
        let displays = displays(&egl, wanted);
        let mut why = match wanted {
            Some(number) => format!("EGL has no device {number}, which {DEVICE_VARIABLE} requests"),
            None => "EGL has no device".to_owned(),
        };
        for display in displays {
            match context(&egl, display) {
                Ok((context, surface)) => {
                    let mut gl = Self { egl, display, context, surface, name: String::new() };
                    gl.make_current()?;
                    gl.name = gl.describe()?;
                    return Ok(gl);
                }
                Err(error) => why = error.to_string(),
            }
        }
        Err(format!(
            "no EGL device supports OpenGL: {why}\nHint: Mesa renders without a GPU; on Debian and Ubuntu: apt-get install \
             libegl1 libgl1 libgl1-mesa-dri"
        ))
    }

    /// Makes the context current in this thread.
    pub(crate) fn make_current(&self) -> Result<(), String> {
        self.egl
            .make_current(self.display, Some(self.surface), Some(self.surface), Some(self.context))
            .map_err(|error| format!("EGL cannot make the context current in this thread: {error}"))
    }

    /// The renderer and its version.
    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    fn describe(&self) -> Result<String, String> {
        let entry = self.egl.get_proc_address("glGetString").ok_or("OpenGL has no function glGetString")?;
        // SAFETY: this is the signature of `glGetString`, and the context is current.
        #[expect(unsafe_code, reason = "calls an OpenGL function")]
        let get = unsafe { std::mem::transmute::<extern "system" fn(), GetString>(entry) };
        let text = |what: c_uint| {
            // SAFETY: the context is current; OpenGL returns null or a static string.
            #[expect(unsafe_code, reason = "calls an OpenGL function")]
            unsafe {
                let text = get(what);
                (!text.is_null()).then(|| CStr::from_ptr(text).to_string_lossy().into_owned())
            }
        };
        let extensions = text(EXTENSIONS).unwrap_or_default();
        if let Some(missing) = NEEDED.iter().find(|name| !extensions.split(' ').any(|known| known == **name)) {
            return Err(format!("OpenGL lacks {missing}, which MuJoCo requires"));
        }
        let named = |what| text(what).unwrap_or_else(|| "unknown".to_owned());
        Ok(format!("{}; OpenGL {}", named(RENDERER), named(VERSION)))
    }
}

impl Drop for Gl {
    fn drop(&mut self) {
        // The process shares the display, so it stays open. A destructor cannot report errors.
        if self.egl.get_current_context() == Some(self.context) {
            let _ = self.egl.make_current(self.display, None, None, None);
        }
        let _ = self.egl.destroy_surface(self.display, self.surface);
        let _ = self.egl.destroy_context(self.display, self.context);
    }
}

/// The displays to try: the requested device only, or every device in EGL's order and then Mesa's surfaceless platform.
fn displays(egl: &egl::DynamicInstance<egl::EGL1_5>, wanted: Option<usize>) -> Vec<egl::Display> {
    let platform = |platform: egl::Enum, native: *mut c_void| {
        // SAFETY: a device comes from EGL's list; the surfaceless platform has none.
        #[expect(unsafe_code, reason = "EGL takes a device as a bare pointer")]
        unsafe { egl.get_platform_display(platform, native, &[egl::ATTRIB_NONE]) }.ok()
    };
    let mut devices = [std::ptr::null_mut(); 32];
    let mut count = 0;
    if let Some(entry) = egl.get_proc_address("eglQueryDevicesEXT") {
        // SAFETY: this is the signature of `eglQueryDevicesEXT` (EGL_EXT_device_enumeration), which writes no more
        // devices than fit into the array.
        #[expect(unsafe_code, reason = "calls an extension function")]
        unsafe {
            let query = std::mem::transmute::<extern "system" fn(), QueryDevices>(entry);
            if query(devices.len() as egl::Int, devices.as_mut_ptr(), &raw mut count) != egl::TRUE {
                count = 0;
            }
        }
    }
    let count = usize::try_from(count).unwrap_or(0).min(devices.len());
    let mut found: Vec<_> = devices[..count]
        .iter()
        .enumerate()
        .filter(|(number, _)| wanted.is_none_or(|wanted| wanted == *number))
        .filter_map(|(_, device)| platform(PLATFORM_DEVICE, *device))
        .collect();
    if wanted.is_none() {
        found.extend(platform(PLATFORM_SURFACELESS, std::ptr::null_mut()));
    }
    found
}

/// An OpenGL context on a display, with an unused surface: MuJoCo renders into its own buffers.
fn context(
    egl: &egl::DynamicInstance<egl::EGL1_5>,
    display: egl::Display,
) -> Result<(egl::Context, egl::Surface), egl::Error> {
    egl.initialize(display)?;
    egl.bind_api(egl::OPENGL_API)?;
    let wanted = [
        (egl::SURFACE_TYPE, egl::PBUFFER_BIT),
        (egl::RENDERABLE_TYPE, egl::OPENGL_BIT),
        (egl::RED_SIZE, 8),
        (egl::GREEN_SIZE, 8),
        (egl::BLUE_SIZE, 8),
    ];
    let attributes: Vec<egl::Int> =
        wanted.iter().flat_map(|(name, value)| [*name, *value]).chain([egl::NONE]).collect();
    let config = egl.choose_first_config(display, &attributes)?.ok_or(egl::Error::BadConfig)?;
    let context = egl.create_context(display, config, None, &[egl::NONE])?;
    let size = [egl::WIDTH, 8, egl::HEIGHT, 8, egl::NONE];
    match egl.create_pbuffer_surface(display, config, &size) {
        Ok(surface) => Ok((context, surface)),
        Err(error) => {
            let _ = egl.destroy_context(display, context);
            Err(error)
        }
    }
}
