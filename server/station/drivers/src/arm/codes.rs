//! What the box's error and warning numbers mean, and what an operator can do.

/// The error between the kinematic one and a joint's limit.
const SELF_COLLISION: u8 = 0x16;

/// An error of the box in words: what happened and what to do.
pub(crate) fn explain_error(code: u8) -> String {
    let (what, mend) = match code {
        1 => (
            "the emergency stop button is pressed",
            "make sure that nobody is in reach, turn the button to release it",
        ),
        2 => ("the emergency stop input of the control box is open", "close the external stop circuit"),
        3 => ("the three-position switch is released or pressed through", "bring it to its middle position"),
        10 => ("a servo reports an error", "look at the joints' states in the vendor's studio"),
        11..=17 => {
            return sentence(
                &format!("the servo of joint {} reports an error", code - 10),
                code,
                "let it cool down and look at its state in the vendor's studio",
            );
        }
        19 | 28 => ("the tool at the flange does not answer the box", "check the tool's plug at the flange"),
        21 => ("no joint angles reach the commanded pose", "command another pose"),
        SELF_COLLISION => ("the arm would collide with itself", "lead it by hand out of the pose"),
        23 => ("a joint is beyond its limit", "lead the arm by hand back within its limits"),
        24 => (
            "a joint was commanded faster than it may move",
            "lower the velocity limits of the station's file",
        ),
        25 => ("the box could not plan the motion", "command another motion"),
        26 => ("the box missed its own real-time cycle", "restart the control box if it happens again"),
        30 => ("a joint moves at another speed than commanded", "check the load and the payload settings"),
        31 => (
            "a collision: a joint needed more current than its motion explains",
            "free the arm and what it touches",
        ),
        35 => ("the tool left the workspace that is set in the box", "lead the arm by hand back into it"),
        36 => {
            ("too many commands reached the box late", "check the network between this computer and the box")
        }
        37 => ("lead-through went wrong", "check mounting direction and payload settings"),
        38 => (
            "a joint's angle makes no sense",
            "restart the control box, then calibrate the joint if it stays",
        ),
        60 => (
            "the tool was commanded faster than servo mode allows",
            "lower the velocity limits of the station's file",
        ),
        _ => ("an error that this program does not know", "look it up in the vendor's manual"),
    };
    sentence(what, code, mend)
}

/// A warning of the box in words.
pub(crate) fn explain_warning(code: u8) -> String {
    let (what, mend) = match code {
        11 => ("the box's queue of commands is full", "wait until it has moved"),
        12 => (
            "the box was given a parameter that it does not take",
            "check payload and limits of the station's file",
        ),
        13 => ("the box does not know a command", "update the firmware of the control box"),
        14 => ("the box found no joint angles for a pose", "command another pose"),
        15 => ("the tool's line is busy", "end other programs that talk to the tool"),
        _ => ("a warning that this program does not know", "look it up in the vendor's manual"),
    };
    format!("{what} (warning {code} of the arm): {mend}; clearing the fault clears it")
}

fn sentence(what: &str, code: u8, mend: &str) -> String {
    format!("{what} (error {code} of the arm): {mend}, then clear the fault and arm again")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_documented_code_is_explained_with_its_number_and_what_to_do() {
        let documented =
            [1, 2, 3, 10, 11, 17, 19, 21, SELF_COLLISION, 23, 24, 25, 26, 28, 30, 31, 35, 36, 37, 38, 60];
        for code in documented {
            let text = explain_error(code);
            assert!(text.contains(&format!("error {code} ")) && !text.contains("does not know"), "{text}");
            assert!(text.contains("clear the fault"), "{text}");
        }
        assert!(explain_error(13).contains("joint 3"));
        assert!(explain_error(99).contains("error 99") && explain_error(99).contains("manual"));
        for code in 11..=15 {
            let text = explain_warning(code);
            assert!(text.contains(&format!("warning {code} ")) && !text.contains("this program"), "{text}");
        }
    }
}
