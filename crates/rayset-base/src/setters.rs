//! Setters of options, so that options can be added without breaking callers.

/// Defines a method `with_…` for each field, which takes its value:
/// `setters!(Options { with_size => size: u32, … })`.
#[macro_export]
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
