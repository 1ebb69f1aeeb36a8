//! The constants that a simulated drive rests on.

use firmware::params::Constant;
use maud::html;

use crate::report::Section;
use crate::report::tables::table;
use crate::show;

/// A table of them.
pub fn section(assumed: &[Constant]) -> Section {
    let rows = assumed.iter().map(|constant| {
        vec![
            html! { (constant.name) },
            html! { (show::plain(constant.value, 6)) },
            html! { (constant.unit) },
            html! { (constant.source) },
        ]
    });
    let body = html! {
        p { "No motor was at hand, and the paper names none. Every figure on this page is simulated and rests on these." }
        (table("Assumed", &["constant", "value", "unit", "why"], rows))
        p.note { "Left out: the ripple of the pulses within a period, vibration of fingers and flexures, saturation of iron, "
            "heat, wear." }
    };
    Section {
        id: "assumed",
        heading: "What is assumed".to_owned(),
        body,
    }
}
