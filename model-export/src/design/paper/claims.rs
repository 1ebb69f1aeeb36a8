//! The paper's statements, each computed.

use nalgebra::{DMatrix, DVector};

use super::curves::{cylinder, facing, four_shapes, greatest, sensitivity, steps};
use super::{GAP_MM, HEIGHT_MM};
use crate::design::interference::{earth, neighbour};
use crate::design::sweep::Candidate;

/// Resolution that the paper counts with, in gauss.
const RESOLUTION_G: f64 = 0.1;

/// What became of a statement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// It is so.
    Reproduced,
    /// It is otherwise.
    NotReproduced,
    /// It contradicts physics, or the paper itself.
    Impossible,
}

impl Verdict {
    /// In words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Reproduced => "reproduced",
            Self::NotReproduced => "not reproduced",
            Self::Impossible => "impossible as stated",
        }
    }

    fn if_so(so: bool) -> Self {
        match so {
            true => Self::Reproduced,
            false => Self::NotReproduced,
        }
    }
}

/// A statement of the paper.
#[derive(Clone, Debug, PartialEq)]
pub struct Claim {
    /// What it says.
    pub says: &'static str,
    /// Where.
    pub place: &'static str,
    /// What is found.
    pub found: String,
    /// What became of it.
    pub verdict: Verdict,
}

/// All of them; the designs are those of ABS and of steel.
pub fn of(designs: &[Vec<Candidate>; 2]) -> Vec<Claim> {
    let [plastic, metal] = designs;
    vec![
        patterns(),
        constant(),
        logarithm(),
        diameter(),
        proportional(),
        plastic_range(plastic),
        metal_range(metal),
        alike(plastic, metal),
        closed(),
        earth(),
    ]
}

/// Least S by the greatest within `motion_mm` of rest.
fn constancy(diameter_mm: f64, motion_mm: f64) -> f64 {
    let model = cylinder(diameter_mm, HEIGHT_MM, GAP_MM);
    let sizes = steps(0.0, motion_mm).map(|x_mm| sensitivity(&model, x_mm).abs());
    let (least, most) = sizes.fold((f64::INFINITY, 0.0_f64), |(least, most), size| {
        (least.min(size), most.max(size))
    });
    least / most
}

fn patterns() -> Claim {
    let fields = four_shapes().map(|(_, shape)| {
        let model = facing(shape, GAP_MM);
        let at = |x_mm: f64| {
            model
                .respond(nalgebra::Vector3::new(x_mm, 0.0, 0.0))
                .field_g
                .x
        };
        (
            at(0.1),
            steps(0.0, 0.1)
                .map(|x_mm| at(x_mm) / at(0.1))
                .collect::<Vec<_>>(),
        )
    });
    let (_, first) = &fields[0];
    let differs = fields
        .iter()
        .flat_map(|(_, pattern)| pattern.iter().zip(first).map(|(a, b)| (a - b).abs()));
    let differs = differs.fold(0.0, f64::max);
    let sizes = fields.each_ref().map(|(size, _)| *size);
    Claim {
        says: "cube and sphere do not affect the signal's pattern at motions of micrometres",
        place: "IV-B",
        found: format!(
            "within 0.1 mm the four patterns, each by its own size, differ by {:.2} %; their sizes by {:.0} %",
            100.0 * differs,
            100.0
                * (sizes.iter().copied().fold(0.0, f64::max)
                    / sizes.iter().copied().fold(f64::INFINITY, f64::min)
                    - 1.0),
        ),
        verdict: Verdict::if_so(differs < 0.01),
    }
}

fn constant() -> Claim {
    let [wide, narrow] = [5.0, 3.0].map(|diameter_mm| 1.0 - constancy(diameter_mm, 0.6));
    Claim {
        says: "with a diameter of 5 mm S is nearly constant within 0.6 mm of rest",
        place: "V-B",
        found: format!(
            "S changes by {:.1} % there (length 2 mm, gap 1.5 mm); with 3 mm by {:.1} %",
            100.0 * wide,
            100.0 * narrow
        ),
        verdict: Verdict::if_so(wide < 0.05),
    }
}

/// Share of the spread of S over the length that `a + b ln L` explains.
fn log_share(from_mm: f64, to_mm: f64) -> f64 {
    let points: Vec<[f64; 2]> = steps(from_mm, to_mm)
        .map(|length_mm| {
            [
                libm::log(length_mm),
                greatest(&cylinder(3.0, length_mm, GAP_MM)).0,
            ]
        })
        .collect();
    let matrix = DMatrix::from_fn(
        points.len(),
        2,
        |i, j| if j == 0 { 1.0 } else { points[i][0] },
    );
    let values = DVector::from_iterator(points.len(), points.iter().map(|point| point[1]));
    let normal = matrix.transpose() * &matrix;
    let Some(inverse) = normal.try_inverse() else {
        return 0.0;
    };
    let left = &values - &matrix * (inverse * (matrix.transpose() * &values));
    1.0 - left.norm_squared() / values.add_scalar(-values.mean()).norm_squared()
}

fn logarithm() -> Claim {
    let [short, long] = [[0.5, 4.0], [0.5, 20.0]].map(|[from, to]| log_share(from, to));
    let doubled =
        greatest(&cylinder(3.0, 20.0, GAP_MM)).0 / greatest(&cylinder(3.0, 10.0, GAP_MM)).0;
    Claim {
        says: "S grows with the magnet's length like a logarithm",
        place: "V-B",
        found: format!(
            "a logarithm explains {:.1} % of the spread from 0.5 to 4 mm and {:.1} % up to 20 mm (diameter 3 mm); \
             it ends: from 10 to 20 mm S grows by {:.1} % only",
            100.0 * short,
            100.0 * long,
            100.0 * (doubled - 1.0)
        ),
        verdict: Verdict::if_so(short > 0.95),
    }
}

fn diameter() -> Claim {
    let sizes: Vec<(f64, f64)> = steps(1.0, 10.0)
        .map(|diameter_mm| {
            (
                diameter_mm,
                sensitivity(&cylinder(diameter_mm, HEIGHT_MM, GAP_MM), 0.0),
            )
        })
        .collect();
    let best = sizes.iter().copied().fold(
        (0.0, 0.0),
        |best: (f64, f64), one| {
            if one.1 > best.1 { one } else { best }
        },
    );
    let last = sizes.last().copied().unwrap_or_default();
    Claim {
        says: "a larger diameter does not always increase the sensitivity",
        place: "V-B",
        found: format!(
            "at rest S is greatest at a diameter of {:.1} mm, {:.0} G/mm, and falls to {:.0} G/mm at {:.0} mm; \
             3 mm, which the paper takes for the highest, has {:.0}",
            best.0,
            best.1,
            last.1,
            last.0,
            sensitivity(&cylinder(3.0, HEIGHT_MM, GAP_MM), 0.0)
        ),
        verdict: Verdict::if_so(best.0 < 9.0),
    }
}

fn proportional() -> Claim {
    let [near, far] = [1.5, 3.0].map(|gap_mm| greatest(&cylinder(3.0, HEIGHT_MM, gap_mm)).0);
    Claim {
        says: "the greatest sensitivity is proportional to the distance",
        place: "V-B",
        found: format!(
            "it falls with the distance: {near:.0} G/mm at 1.5 mm, {far:.0} at 3 mm, as outside of any magnet"
        ),
        verdict: Verdict::Impossible,
    }
}

/// The design with the greatest range.
fn furthest(designs: &[Candidate]) -> Option<&Candidate> {
    let working = designs.iter().filter(|one| one.works());
    working.max_by(|a, b| a.range_n.total_cmp(&b.range_n))
}

fn plastic_range(designs: &[Candidate]) -> Claim {
    let most = furthest(designs);
    let range_n = most.map_or(0.0, |one| one.range_n);
    let why = most.map_or("nothing", |one| one.cause.name());
    Claim {
        says: "of ABS, the greatest force range is 200 N",
        place: "V-B",
        found: format!(
            "{range_n:.0} N, ended by {why}, with beams of up to 20 by 8 mm and a safety of 1.5 at 10^7 cycles; \
             the paper does not say what it swept, and the range grows with the section"
        ),
        verdict: Verdict::if_so((150.0..250.0).contains(&range_n)),
    }
}

fn metal_range(designs: &[Candidate]) -> Claim {
    let strong = || {
        designs
            .iter()
            .filter(|one| one.works() && one.range_n >= 800.0)
    };
    let most = strong().map(|one| one.g_per_n).fold(0.0, f64::max);
    Claim {
        says: "metal reaches 800 N, at less than 10 G/N",
        place: "V-B",
        found: format!(
            "{} of {} steel designs bear 800 N, at {most:.2} G/N at the most: what moves by 0.5 mm at 800 N has \
             1600 N/mm, and no magnet has the 16,000 G/mm that 10 G/N would ask",
            strong().count(),
            designs.len()
        ),
        verdict: Verdict::if_so(most > 0.0 && most < 10.0),
    }
}

fn alike(plastic: &[Candidate], metal: &[Candidate]) -> Claim {
    let low = |designs: &[Candidate]| {
        let inside = designs
            .iter()
            .filter(|one| one.works() && (20.0..100.0).contains(&one.range_n));
        inside.map(|one| one.g_per_n).fold(0.0, f64::max)
    };
    let [plastic, metal] = [low(plastic), low(metal)];
    Claim {
        says: "metal and plastic alike reach 10 G/N below 100 N",
        place: "V-B",
        found: format!(
            "of designs for 20 to 100 N, up to {plastic:.0} G/N of ABS and {metal:.0} G/N of steel"
        ),
        verdict: Verdict::if_so(plastic >= 10.0 && metal >= 10.0),
    }
}

fn closed() -> Claim {
    let model = cylinder(3.0, HEIGHT_MM, GAP_MM);
    // Faces 1.5 mm apart, side by side: centres 4.5 mm.
    let near_g = neighbour::field(&model, 3.0 + 1.5).norm();
    let most_g = 3.0 * RESOLUTION_G;
    let distance_mm = neighbour::distance_mm(&model, most_g);
    Claim {
        says: "closed, with the opposite magnet 1.5 mm away, it disturbs by less than 3 resolutions",
        place: "V-B",
        found: format!(
            "{near_g:.0} G, {:.0} resolutions of 0.1 G; below three only from {distance_mm:.0} mm on",
            near_g / RESOLUTION_G
        ),
        verdict: match near_g < most_g {
            true => Verdict::Reproduced,
            false => Verdict::Impossible,
        },
    }
}

fn earth() -> Claim {
    let [least, most] = [earth::LEAST.value, earth::GREATEST.value];
    Claim {
        says: "the Earth's field is about 0.5 uT, hence negligible",
        place: "IV-C",
        found: format!(
            "{:.0} to {:.0} uT: {:.1} to {:.1} resolutions of 0.1 G",
            100.0 * least,
            100.0 * most,
            least / RESOLUTION_G,
            most / RESOLUTION_G
        ),
        verdict: Verdict::Impossible,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_paper_s_five_millimetres_are_nearly_constant_and_its_three_are_not() {
        // S = 585 - 240 x^2 with x in mm for 3 mm: 15 % at 0.6.
        assert!(1.0 - constancy(5.0, 0.6) < 0.05);
        let narrow = 1.0 - constancy(3.0, 0.6);
        assert!((0.12..0.18).contains(&narrow), "{narrow}");
    }

    #[test]
    fn every_statement_has_its_verdict() {
        let verdicts = |claim: &Claim| (claim.place, claim.verdict);
        assert_eq!(constant().verdict, Verdict::Reproduced);
        assert_eq!(diameter().verdict, Verdict::Reproduced);
        assert_eq!(proportional().verdict, Verdict::Impossible);
        assert_eq!(closed().verdict, Verdict::Impossible);
        assert_eq!(earth().verdict, Verdict::Impossible);
        // Without designs nothing is reproduced of them.
        let none = of(&[Vec::new(), Vec::new()]);
        assert_eq!(none.len(), 10);
        let materials: Vec<_> = none[5..8].iter().map(verdicts).collect();
        assert!(
            materials
                .iter()
                .all(|(_, verdict)| *verdict == Verdict::NotReproduced)
        );
    }
}
