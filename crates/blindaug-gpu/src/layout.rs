//! Structs that Rust and shaders share, declared once in Rust: the macro [`wgsl_struct`] makes the plain data that is uploaded and the WGSL
//! text of the same struct.
//!
//! WGSL aligns vectors, Rust does not. So padding is written out as fields, and a struct whose fields would lie elsewhere in WGSL does not
//! compile. A test compares all structs with naga's layout of them.
//!
//! Existing crates do not fit: `encase` copies each struct field by field at run time and writes no WGSL, `wgsl_bindgen` generates Rust
//! from WGSL at build time, with a build script and a dozen dependencies.

use std::fmt::Write;

/// A Rust type that has the memory layout of a WGSL type.
pub(crate) trait HostType {
    /// The alignment of the WGSL type, bytes.
    const ALIGN: usize;

    /// The name of the WGSL type.
    fn wgsl() -> String;
}

macro_rules! host_types {
    ($($rust:ty, $align:literal, $wgsl:literal;)*) => {
        $(impl HostType for $rust {
            const ALIGN: usize = $align;

            fn wgsl() -> String {
                $wgsl.into()
            }
        })*
    };
}

host_types! {
    f32, 4, "f32";
    u32, 4, "u32";
    [f32; 2], 8, "vec2f";
    [f32; 3], 16, "vec3f";
    [f32; 4], 16, "vec4f";
    [u32; 2], 8, "vec2u";
    [u32; 4], 16, "vec4u";
}

impl<T, const N: usize, const LEN: usize> HostType for [[T; N]; LEN]
where
    [T; N]: HostType,
{
    const ALIGN: usize = <[T; N]>::ALIGN;

    fn wgsl() -> String {
        format!("array<{}, {LEN}>", <[T; N]>::wgsl())
    }
}

/// A field of a struct.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Field {
    /// The name of the field in Rust and WGSL.
    pub(crate) name: &'static str,
    /// The offset of the field in Rust, bytes.
    pub(crate) offset: usize,
    /// The size of the field in Rust, bytes.
    pub(crate) size: usize,
    /// The alignment of the field in WGSL, bytes.
    pub(crate) align: usize,
    /// The name of the field's WGSL type.
    pub(crate) wgsl: fn() -> String,
}

/// A struct that Rust and WGSL share.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Layout {
    /// The name of the struct in Rust and WGSL.
    pub(crate) name: &'static str,
    /// The fields of the struct, in their order.
    pub(crate) fields: &'static [Field],
    /// The size of the struct in Rust, bytes.
    pub(crate) size: usize,
}

impl Layout {
    /// Whether WGSL puts all fields where Rust puts them, and makes the struct as long.
    pub(crate) const fn agrees(&self) -> bool {
        let (mut end, mut align, mut i) = (0usize, 1, 0);
        while i < self.fields.len() {
            let Field { offset, size, align: own, .. } = self.fields[i];
            if offset != end.next_multiple_of(own) {
                return false;
            }
            end = offset + size;
            align = if own > align { own } else { align };
            i += 1;
        }
        self.size == end.next_multiple_of(align)
    }

    /// The struct's declaration in WGSL.
    pub(crate) fn declaration(&self) -> String {
        let mut text = format!("struct {} {{\n", self.name);
        for field in self.fields {
            // Writing to a String cannot fail.
            let _ = writeln!(text, "    {}: {},", field.name, (field.wgsl)());
        }
        text + "}\n"
    }
}

/// The WGSL declarations of structs.
pub(crate) fn structs(layouts: &[Layout]) -> String {
    layouts.iter().map(Layout::declaration).collect()
}

/// Declares plain data that a shader reads or writes; its associated constant `LAYOUT` has the struct for WGSL. A struct that WGSL would
/// lay out otherwise does not compile.
macro_rules! wgsl_struct {
    (
        $(#[$meta:meta])*
        $vis:vis struct $name:ident {
            $($(#[$field_meta:meta])* $field_vis:vis $field:ident: $type:ty,)*
        }
    ) => {
        $(#[$meta])*
        #[repr(C)]
        #[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
        #[allow(dead_code, reason = "what only shaders write and read counts here by its size")]
        $vis struct $name {
            $($(#[$field_meta])* $field_vis $field: $type,)*
        }

        // All numbers are 0. Arrays of more than 32 elements have no default of their own.
        impl Default for $name {
            fn default() -> Self {
                bytemuck::Zeroable::zeroed()
            }
        }

        impl $name {
            /// The same struct for WGSL.
            pub(crate) const LAYOUT: $crate::layout::Layout = $crate::layout::Layout {
                name: stringify!($name),
                fields: &[$($crate::layout::Field {
                    name: stringify!($field),
                    offset: std::mem::offset_of!($name, $field),
                    size: size_of::<$type>(),
                    align: <$type as $crate::layout::HostType>::ALIGN,
                    wgsl: <$type as $crate::layout::HostType>::wgsl,
                }),*],
                size: size_of::<$name>(),
            };
        }

        const _: () = assert!($name::LAYOUT.agrees(), "WGSL would lay this struct out otherwise: add padding");
    };
}
pub(crate) use wgsl_struct;

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A struct's name, the name, offset and size of each of its fields, and its own size; all in bytes.
    pub(crate) type Struct = (String, Vec<(String, usize, usize)>, usize);

    /// The structs of a WGSL text, as naga lays them out.
    pub(crate) fn as_naga_has_them(source: &str) -> Vec<Struct> {
        let module =
            naga::front::wgsl::parse_str(source).unwrap_or_else(|e| panic!("{}", e.emit_to_string(source)));
        let size = |t: naga::Handle<naga::Type>| module.types[t].inner.size(module.to_ctx()) as usize;
        let structs = module.types.iter().filter_map(|(_, t)| match &t.inner {
            naga::TypeInner::Struct { members, span } => {
                let field = |m: &naga::StructMember| {
                    (m.name.clone().unwrap_or_default(), m.offset as usize, size(m.ty))
                };
                Some((t.name.clone()?, members.iter().map(field).collect(), *span as usize))
            }
            _ => None,
        });
        structs.collect()
    }

    /// The structs of layouts, as Rust lays them out.
    pub(crate) fn as_rust_has_them(layouts: &[Layout]) -> Vec<Struct> {
        let fields = |l: &Layout| l.fields.iter().map(|f| (f.name.to_string(), f.offset, f.size)).collect();
        layouts.iter().map(|l| (l.name.to_string(), fields(l), l.size)).collect()
    }

    #[test]
    fn a_struct_without_its_padding_is_found_out() {
        /// A number before a vector, which WGSL moves to 8 bytes.
        #[repr(C)]
        struct Wrong {
            number: f32,
            vector: [f32; 2],
        }
        let field = |name, offset, size, align, wgsl| Field { name, offset, size, align, wgsl };
        let fields = [
            field("number", std::mem::offset_of!(Wrong, number), 4, f32::ALIGN, f32::wgsl as fn() -> String),
            field("vector", std::mem::offset_of!(Wrong, vector), 8, <[f32; 2]>::ALIGN, <[f32; 2]>::wgsl),
        ];
        let wrong = Layout { name: "Wrong", fields: Box::leak(Box::new(fields)), size: size_of::<Wrong>() };
        assert!(!wrong.agrees());
        assert_ne!(as_naga_has_them(&structs(&[wrong])), as_rust_has_them(&[wrong]));
        // A struct that WGSL makes longer is found out too, and one that is right passes.
        let [number, _] = fields;
        let long = Layout { fields: Box::leak(Box::new([number])), size: 16, ..wrong };
        let right = Layout { size: 4, ..long };
        assert!(!long.agrees() && right.agrees());
        assert_eq!(as_naga_has_them(&structs(&[right])), as_rust_has_them(&[right]));
    }
}
