//! The firmware: initialises the board and spawns the tasks. On a computer it prints the design constants.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
use defmt_rtt as _;

#[cfg(target_os = "none")]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    firmware::board::selected::crash::panicked()
}

#[cfg(target_os = "none")]
#[embassy_executor::main]
async fn main(spawner: embassy_executor::Spawner) {
    firmware::board::selected::tasks::start(spawner);
}

#[cfg(not(target_os = "none"))]
fn main() {
    println!("MAGPIE gripper, design constants (* = assumed, confirm on your own hardware)");
    for constant in firmware::config::constants::ALL {
        println!(
            "{} {:<26} {:>9} {:<6} {}",
            if constant.is_assumed() { "*" } else { " " },
            constant.name,
            constant.value,
            constant.unit,
            constant.source
        );
    }
}
