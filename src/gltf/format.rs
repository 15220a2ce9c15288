//! Element formats of accessors.

use std::fmt;

use ::gltf::json;
use json::accessor::{ComponentType, IndexComponentType, Type};
use json::validation::Checked::{self, Valid};

/// Shape and component type of an element.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Format {
    pub(super) shape: Shape,
    pub(super) component: Component,
    /// Whether integers are normalized: they stand for 0 to 1 or, if signed, -1 to 1.
    pub(super) normalized: bool,
}

/// Number of components of a vector, or of rows and columns of a square matrix.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Shape {
    Vector(usize),
    Matrix(usize),
}

/// Type of a component.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Format {
    /// The format of an accessor; `None` if glTF does not define it.
    pub(super) fn of(accessor: &json::Accessor) -> Option<Self> {
        let (Valid(kind), Valid(component)) = (&accessor.type_, &accessor.component_type) else { return None };
        let shape = match kind {
            Type::Scalar => Shape::Vector(1),
            Type::Vec2 => Shape::Vector(2),
            Type::Vec3 => Shape::Vector(3),
            Type::Vec4 => Shape::Vector(4),
            Type::Mat2 => Shape::Matrix(2),
            Type::Mat3 => Shape::Matrix(3),
            Type::Mat4 => Shape::Matrix(4),
        };
        Some(Self { shape, component: component.0.into(), normalized: accessor.normalized })
    }

    /// Whether it is a vector of that many components.
    pub(super) fn is_vector(self, components: usize) -> bool {
        self.shape == Shape::Vector(components)
    }

    /// Whether its components are f32 or normalized integers.
    pub(super) fn is_float_or_normalized(self) -> bool {
        match self.component {
            Component::F32 => true,
            Component::U32 => false,
            _ => self.normalized,
        }
    }

    /// Bytes of an element. The columns of matrices are aligned to 4 bytes.
    pub(super) fn size(self) -> usize {
        match self.shape {
            Shape::Vector(n) => n * self.component.size(),
            Shape::Matrix(n) => self.stride() / n * (n - 1) + n * self.component.size(),
        }
    }

    /// Bytes from one element to the next if the file gives no `byteStride`: elements are tightly packed, but the last
    /// column of a matrix is padded to 4 bytes as the others.
    pub(super) fn stride(self) -> usize {
        match self.shape {
            Shape::Vector(_) => self.size(),
            Shape::Matrix(n) => n * (n * self.component.size()).next_multiple_of(4),
        }
    }
}

impl Shape {
    /// Components of an element.
    pub(super) fn components(self) -> usize {
        match self {
            Self::Vector(n) => n,
            Self::Matrix(n) => n * n,
        }
    }
}

impl Component {
    /// The type of sparse indices; `None` if glTF does not define it.
    pub(super) fn of_indices(component: &Checked<IndexComponentType>) -> Option<Self> {
        match component {
            Valid(component) => Some(component.0.into()),
            Checked::Invalid => None,
        }
    }

    /// Bytes of a component.
    pub(super) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }
}

impl From<ComponentType> for Component {
    fn from(component: ComponentType) -> Self {
        match component {
            ComponentType::I8 => Self::I8,
            ComponentType::U8 => Self::U8,
            ComponentType::I16 => Self::I16,
            ComponentType::U16 => Self::U16,
            ComponentType::U32 => Self::U32,
            ComponentType::F32 => Self::F32,
        }
    }
}

impl fmt::Display for Format {
    /// As the glTF specification writes it: "VEC3 of normalized unsigned byte".
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.shape {
            Shape::Vector(1) => f.write_str("SCALAR")?,
            Shape::Vector(n) => write!(f, "VEC{n}")?,
            Shape::Matrix(n) => write!(f, "MAT{n}")?,
        }
        f.write_str(if self.normalized { " of normalized " } else { " of " })?;
        f.write_str(match self.component {
            Component::I8 => "byte",
            Component::U8 => "unsigned byte",
            Component::I16 => "short",
            Component::U16 => "unsigned short",
            Component::U32 => "unsigned int",
            Component::F32 => "float",
        })
    }
}
