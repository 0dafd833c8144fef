//! Geometry as plain numbers, for messages and files.

use nalgebra::{Isometry3, Matrix3, Quaternion, Translation3, UnitQuaternion, Vector3};
use robogate_core::Pose;
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::{Color, pose};

/// Largest difference of the squared norm of a unit quaternion from 1.
const NORM: f64 = 2e-6;

/// A pose as an isometry. Its quaternion is not normalised, which would change its bits.
///
/// # Errors
/// If the quaternion is not a unit quaternion.
pub fn exact_isometry(pose: &Pose) -> Result<Isometry3<f64>, String> {
    let [w, x, y, z] = pose.orientation;
    let quaternion = Quaternion::new(w, x, y, z);
    if (quaternion.norm_squared() - 1.0).abs() > NORM {
        return Err(format!("the quaternion {:?}, which is not a unit quaternion", pose.orientation));
    }
    let rotation = UnitQuaternion::new_unchecked(quaternion);
    Ok(Isometry3::from_parts(Translation3::from(Vector3::from(pose.position)), rotation))
}

/// A type as it is written in a message.
pub(crate) trait Plain: Sized {
    type Written: Serialize + for<'a> Deserialize<'a>;

    fn written(&self) -> Self::Written;

    fn read(written: Self::Written) -> Result<Self, String>;
}

impl Plain for Isometry3<f64> {
    type Written = Pose;

    fn written(&self) -> Pose {
        pose(self)
    }

    fn read(written: Pose) -> Result<Self, String> {
        exact_isometry(&written)
    }
}

impl Plain for Vector3<f64> {
    type Written = [f64; 3];

    fn written(&self) -> [f64; 3] {
        (*self).into()
    }

    fn read(written: [f64; 3]) -> Result<Self, String> {
        Ok(written.into())
    }
}

/// Row by row.
impl Plain for Matrix3<f64> {
    type Written = [[f64; 3]; 3];

    fn written(&self) -> [[f64; 3]; 3] {
        [0, 1, 2].map(|row| [self[(row, 0)], self[(row, 1)], self[(row, 2)]])
    }

    fn read(written: [[f64; 3]; 3]) -> Result<Self, String> {
        Ok(Self::from_fn(|row, column| written[row][column]))
    }
}

/// As `#rrggbb`.
impl Plain for Color {
    type Written = String;

    fn written(&self) -> String {
        self.to_string()
    }

    fn read(written: String) -> Result<Self, String> {
        Self::from_hex(&written).ok_or_else(|| "a colour that is not written as #rrggbb".to_owned())
    }
}

/// For `serde(with)`.
pub(crate) fn serialize<T: Plain, S: Serializer>(value: &T, serializer: S) -> Result<S::Ok, S::Error> {
    value.written().serialize(serializer)
}

/// For `serde(with)`.
pub(crate) fn deserialize<'de, T: Plain, D: Deserializer<'de>>(deserializer: D) -> Result<T, D::Error> {
    T::read(T::Written::deserialize(deserializer)?).map_err(D::Error::custom)
}
