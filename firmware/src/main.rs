//! The firmware: on the gripper's microcontroller it brings up the board and spawns the tasks; on a
//! computer it prints the parameter card.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
use defmt_rtt as _;

#[cfg(target_os = "none")]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    firmware::hardware::crash::panicked()
}

#[cfg(target_os = "none")]
#[embassy_executor::main]
async fn main(spawner: embassy_executor::Spawner) {
    let board = firmware::hardware::board::bring_up();
    firmware::tasks::start(spawner, board);
}

#[cfg(not(target_os = "none"))]
fn main() {
    println!("MAGPIE gripper, design constants (* = assumed, confirm on your own hardware)");
    for constant in firmware::params::CARD {
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
