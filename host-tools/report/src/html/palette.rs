//! Colours of the report: distinguishable with colour-blindness, in light and dark mode.
//!
//! Plots use the literal colours of light mode; the page's style maps each to a variable
//! of the reader's scheme, so that plots remain legible without the style.

use std::fmt::Write as _;

use plotters::style::RGBColor;

/// Colour with a meaning.
#[derive(Clone, Copy, Debug)]
pub struct Role {
    pub name: &'static str,
    pub light: RGBColor,
    pub dark: RGBColor,
}

/// Text, axes and measured values.
pub const INK: Role =
    Role { name: "ink", light: RGBColor(0x1A, 0x1B, 0x1E), dark: RGBColor(0xEC, 0xED, 0xEF) };
pub const MUTED: Role =
    Role { name: "muted", light: RGBColor(0x5C, 0x60, 0x66), dark: RGBColor(0xA6, 0xAB, 0xB3) };
/// Grid lines, frames, and cells without data.
pub const GRID: Role =
    Role { name: "grid", light: RGBColor(0xDD, 0xDF, 0xE3), dark: RGBColor(0x3A, 0x3E, 0x45) };
/// First model; x axis.
pub const FIRST: Role =
    Role { name: "first", light: RGBColor(0x00, 0x72, 0xB2), dark: RGBColor(0x56, 0xB4, 0xE9) };
/// Second model; y axis.
pub const SECOND: Role =
    Role { name: "second", light: RGBColor(0xD5, 0x5E, 0x00), dark: RGBColor(0xE6, 0x9F, 0x00) };
/// z axis.
pub const THIRD: Role =
    Role { name: "third", light: RGBColor(0x00, 0x9E, 0x73), dark: RGBColor(0x2F, 0xC3, 0x98) };

pub const ALL: [Role; 6] = [INK, MUTED, GRID, FIRST, SECOND, THIRD];
/// Colours of x, y, z.
pub const AXES: [Role; 3] = [FIRST, SECOND, THIRD];

/// CSS that maps the drawn colours to the reader's scheme.
pub fn style() -> String {
    let variables = |colour: fn(&Role) -> RGBColor| {
        ALL.iter().fold(String::new(), |mut text, role| {
            // Writing to a String cannot fail.
            let _ = write!(text, "--{}:{};", role.name, hex(colour(role)));
            text
        })
    };
    let mut style = format!(
        ":root{{{}--paper:#fff;--raised:#f5f6f8}}\n@media screen and (prefers-color-scheme:dark){{:root{{{}--paper:#14161a;--raised:#1f2228}}}}\n",
        variables(|role| role.light),
        variables(|role| role.dark)
    );
    for role in ALL {
        let (name, drawn) = (role.name, hex(role.light));
        let _ = writeln!(
            style,
            "svg [stroke=\"{drawn}\"]{{stroke:var(--{name})}}svg [fill=\"{drawn}\"]{{fill:var(--{name})}}"
        );
    }
    style
}

/// Hexadecimal notation as the SVG backend writes it.
pub fn hex(RGBColor(red, green, blue): RGBColor) -> String {
    format!("#{red:02X}{green:02X}{blue:02X}")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Relative luminance (WCAG).
    fn luminance(RGBColor(red, green, blue): RGBColor) -> f64 {
        let linear = |byte: u8| {
            let share = f64::from(byte) / 255.0;
            if share <= 0.040_45 { share / 12.92 } else { ((share + 0.055) / 1.055).powf(2.4) }
        };
        0.2126 * linear(red) + 0.7152 * linear(green) + 0.0722 * linear(blue)
    }

    fn contrast(a: RGBColor, b: RGBColor) -> f64 {
        let (a, b) = (luminance(a), luminance(b));
        (a.max(b) + 0.05) / (a.min(b) + 0.05)
    }

    #[test]
    fn colours_have_sufficient_contrast_in_both_modes() {
        let (white, black) = (RGBColor(255, 255, 255), RGBColor(0x14, 0x16, 0x1A));
        for (role, least) in [(INK, 12.0), (MUTED, 4.5)] {
            assert!(contrast(role.light, white) > least, "{}", role.name);
            assert!(contrast(role.dark, black) > least, "{}", role.name);
        }
        for role in AXES {
            assert!(contrast(role.light, white) > 3.0, "{}", role.name);
            assert!(contrast(role.dark, black) > 3.0, "{}", role.name);
        }
    }

    #[test]
    fn each_drawn_colour_has_one_role() {
        for (i, role) in ALL.iter().enumerate() {
            assert!(ALL[..i].iter().all(|other| other.light != role.light));
        }
        assert!(style().contains("svg [stroke=\"#0072B2\"]{stroke:var(--first)}"));
    }
}
