use crate::model::table::*;
pub static TABLES: Tables<'static> = Tables { id: 0, exp: &[0; EXP_ENTRIES], sensors: &[] };
