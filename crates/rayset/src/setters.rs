//! Setters of options, so that options can grow without breaking those who set some of them.

/// For each field a method `with_…` that takes its value: `setters!(Options { with_size => size: u32, … })`.
macro_rules! setters {
    ($options:ident { $($setter:ident => $field:ident: $value:ty),* $(,)? }) => {
        impl $options {$(
            #[doc = concat!("Sets [`", stringify!($field), "`](Self::", stringify!($field), ").")]
            #[must_use]
            pub fn $setter(mut self, $field: $value) -> Self {
                self.$field = $field;
                self
            }
        )*}
    };
}

pub(crate) use setters;
