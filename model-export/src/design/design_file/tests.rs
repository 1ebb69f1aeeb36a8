use std::fs;

use super::*;

fn read(text: &str) -> Result<SensorDesign, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("design.toml");
    fs::write(&path, text).unwrap();
    SensorDesign::read(&path).map_err(|problem| problem.to_string())
}

const SHORT: &str = "\
gap_mm = 2.0
magnet = { shape = \"cylinder\", diameter_mm = 4.0, length_mm = 3.0, remanence_t = 1.3, axis = \"y\" }
[flexure_x]
support = \"clamped-free\"
material = \"ABS\"
length_mm = 30.0
width_mm = 15.0
thickness_mm = 8.0
[flexure_z]
support = \"clamped-clamped\"
material = \"Ti-6Al-4V\"
length_mm = 60.0
width_mm = 10.0
thickness_mm = 2.0
";

#[test]
fn magpie_design_equals_the_nominal_design() {
    let design = SensorDesign::magpie();
    let nominal = design.nominal();
    let own = Nominal::magpie();
    assert_eq!(nominal.magnet, own.magnet);
    assert_eq!(nominal.gap_mm, own.gap_mm);
    assert_eq!(nominal.stiffness_x_n_per_mm, 500.0);
    assert_eq!(nominal.stiffness_z_n_per_mm, 800.0);
    // The beam alone has 3403 N/mm: the mount has 586.
    let mount_n_per_mm = 1e-3 / design.mount_m_per_n(0);
    assert!((mount_n_per_mm - 586.1).abs() < 0.1, "{mount_n_per_mm}");
}

#[test]
fn design_file_round_trips() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("design.toml");
    let mut design = SensorDesign::magpie();
    design.material.insert(
        "my wood".to_owned(),
        CustomMaterial {
            modulus_gpa: 12.0,
            yield_mpa: 60.0,
            fatigue_coefficient_mpa: 80.0,
            fatigue_exponent: -0.07,
        },
    );
    design.flexure_z.material = "my wood".to_owned();
    design.stiffness_z_n_per_mm = None;
    fs::write(&path, design.to_toml(&path).unwrap()).unwrap();
    assert_eq!(SensorDesign::read(&path).unwrap(), design);
    assert_eq!(design.strength(1).modulus_pa, 12e9);
    assert!(fs::read_to_string(&path).unwrap().starts_with(MARK));
}

#[test]
fn stiffness_defaults_to_that_of_the_beam() {
    let design = read(SHORT).unwrap();
    // 3 E b h^3 / 12 / L^3 with 2300 MPa; 192 E b h^3 / 12 / L^3 with 113,800.
    let expected = [
        3.0 * 2300.0 * 15.0 * 512.0 / 12.0 / 27_000.0,
        192.0 * 113_800.0 * 10.0 * 8.0 / 12.0 / 216_000.0,
    ];
    for (axis, expected) in expected.into_iter().enumerate() {
        let found = design.stiffness_n_per_mm(axis);
        assert!((found / expected - 1.0).abs() < 1e-12);
        assert_eq!(design.mount_m_per_n(axis), 0.0);
    }
    assert_eq!(design.sensors, 4);
    assert_eq!(design.limits, Requirements::default());
}

#[test]
fn invalid_design_is_reported_with_key_or_line() {
    let message = |from: &str, to: &str| read(&SHORT.replacen(from, to, 1)).unwrap_err();
    for (from, to, words) in [
        ("width_mm = 15.0", "widht_mm = 15.0", ["line 7", "widht_mm"]),
        ("\"ABS\"", "\"abs\"", ["flexure_x.material", "mean \"ABS\""]),
        ("\"ABS\"", "\"cheese\"", ["flexure_x.material", "Ti-6Al-4V"]),
        ("8.0", "-8.0", ["flexure_x.thickness_mm", "above zero"]),
        ("gap_mm = 2.0", "gap_mm = 0", ["gap_mm", "above zero"]),
        (
            "gap_mm = 2.0",
            "gap_mm = 2.0\nstiffness_x_n_per_mm = 900.0",
            ["stiffness_x_n_per_mm", "beam alone has 163.6 N/mm"],
        ),
        ("clamped-free", "glued", ["line 4", "glued"]),
    ] {
        let problem = message(from, to);
        for word in words {
            assert!(problem.contains(word), "{to}: {problem}");
        }
    }
}
