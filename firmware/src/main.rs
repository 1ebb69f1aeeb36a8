//! Prints the parameter card: what this firmware assumes about its gripper.

use firmware::params::CARD;

fn main() {
    println!("MAGPIE gripper, design constants (* = assumed, confirm on your own hardware)");
    for constant in CARD {
        println!(
            "{} {:<26} {:>9} {:<6} {}",
            if constant.assumed { "*" } else { " " },
            constant.name,
            constant.value,
            constant.unit,
            constant.source
        );
    }
}
