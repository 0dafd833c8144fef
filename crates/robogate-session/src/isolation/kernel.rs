//! The sandbox of Linux: Landlock restricts files, seccomp restricts system calls.
//!
//! Landlock cannot restrict everything. The rest is refused by number of the system call: sockets, processes,
//! permissions of files, and what only administrators need. The server listens on a socket that exists before
//! the restrictions, so it needs none.

use std::collections::BTreeMap;
use std::net::TcpListener;
use std::os::fd::{AsRawFd, IntoRawFd};
use std::os::unix::process::CommandExt;
use std::process::{Command, id};

use anyhow::{Context, anyhow};
use caps::{CapSet, Capability};
use landlock::{
    ABI, Access, AccessFs, AccessNet, CompatLevel, Compatible, Ruleset, RulesetAttr, RulesetCreated,
    RulesetCreatedAttr, RulesetError, Scope, path_beneath_rules,
};
use nix::fcntl::{FcntlArg, FdFlag, fcntl};
use nix::libc;
use seccompiler::{
    BpfProgram, SeccompAction, SeccompCmpArgLen, SeccompCmpOp, SeccompCondition, SeccompFilter, SeccompRule,
};

use super::limits::Limits;
use super::sandbox::Rights;

/// The version of Landlock that the sandbox needs: with the size of files (Linux 6.2).
const NEEDED: ABI = ABI::V3;
/// The environment variable with the number of the socket on which Python listens.
const LISTENER: &str = "ROBOGATE_LISTENER";
/// Added to the number of a system call by the ABI x32, whose calls would pass a filter of the other numbers.
#[cfg(target_arch = "x86_64")]
const X32: i64 = 0x4000_0000;

/// Checks that the kernel has the sandbox.
pub(super) fn available() -> anyhow::Result<()> {
    ruleset().map(drop).map_err(|_| {
        anyhow!(
            "this kernel has no sandbox: it needs Linux 6.2 or newer with Landlock\nHint: run it in a virtual machine or on another \
             machine. --sandbox=off runs it with all your rights"
        )
    })
}

/// Restricts this process, and replaces it by the program. Returns only what went wrong.
pub(super) fn become_restricted(rights: &Rights, mut command: Command) -> anyhow::Error {
    match restrict(rights) {
        Ok(listener) => command.env(LISTENER, listener.to_string()).exec().into(),
        Err(why) => why,
    }
}

/// Restricts this process. Returns the number of the listening socket.
fn restrict(rights: &Rights) -> anyhow::Result<i32> {
    Limits::PYTHON.set()?;
    drop_capabilities()?;
    let listener = TcpListener::bind("127.0.0.1:0").context("cannot listen on the loopback interface")?;
    fcntl(&listener, FcntlArg::F_SETFD(FdFlag::empty())).context("cannot keep the listening socket")?;
    ruleset()
        .and_then(|rules| rules.add_rules(path_beneath_rules(&rights.read, AccessFs::from_read(ABI::V5))))
        .and_then(|rules| rules.add_rules(path_beneath_rules(&rights.write, AccessFs::from_all(ABI::V5))))
        .and_then(|rules| rules.add_rules(path_beneath_rules(["/dev/null"], AccessFs::from_file(ABI::V5))))
        .and_then(RulesetCreated::restrict_self)
        .context("cannot restrict the access to files")?;
    for (calls, errno) in [(refused()?, libc::EPERM), (unknown(), libc::ENOSYS)] {
        let filter = SeccompFilter::new(
            calls,
            SeccompAction::Allow,
            SeccompAction::Errno(errno.unsigned_abs()),
            std::env::consts::ARCH.try_into().context("the sandbox does not know this processor")?,
        );
        let program: BpfProgram =
            filter.and_then(TryInto::try_into).context("cannot write the filter of system calls")?;
        seccompiler::apply_filter(&program).context("cannot restrict the system calls")?;
    }
    let number = listener.as_raw_fd();
    // The program that replaces this one owns it.
    let _ = listener.into_raw_fd();
    Ok(number)
}

/// Gives up what an administrator may do, such as reading the environment variables of other processes, which Landlock does not refuse
/// to one. The rights to read and write files of all users stay: Landlock restricts these.
fn drop_capabilities() -> anyhow::Result<()> {
    let kept = [Capability::CAP_DAC_OVERRIDE, Capability::CAP_DAC_READ_SEARCH];
    let lost = || -> Result<(), caps::errors::CapsError> {
        for capability in
            caps::runtime::thread_all_supported().into_iter().filter(|capability| !kept.contains(capability))
        {
            // Only an administrator can have, and give up, what a program could still get.
            if caps::has_cap(None, CapSet::Bounding, capability)?
                && caps::has_cap(None, CapSet::Effective, Capability::CAP_SETPCAP)?
            {
                caps::drop(None, CapSet::Bounding, capability)?;
            }
        }
        for set in [CapSet::Inheritable, CapSet::Effective, CapSet::Permitted] {
            let own = caps::read(None, set)?;
            caps::set(None, set, &own.into_iter().filter(|capability| kept.contains(capability)).collect())?;
        }
        Ok(())
    };
    lost().context("cannot give up the rights of an administrator")
}

/// Everything that Landlock can refuse. Newer kernels also refuse connections, and signals to other
/// processes.
fn ruleset() -> Result<RulesetCreated, RulesetError> {
    Ruleset::default()
        .set_compatibility(CompatLevel::HardRequirement)
        .handle_access(AccessFs::from_all(NEEDED))?
        .set_compatibility(CompatLevel::BestEffort)
        .handle_access(AccessFs::from_all(ABI::V5))?
        .handle_access(AccessNet::from_all(ABI::V4))?
        .scope(Scope::from_all(ABI::V6))?
        .create()
}

type Calls = BTreeMap<i64, Vec<SeccompRule>>;
/// An argument of a system call by its position, how it is compared, and with what.
type Condition = (u8, SeccompCmpOp, u64);

/// System calls that do not exist for the process: the C library uses an older one instead, whose arguments
/// can be checked.
fn unknown() -> Calls {
    with_x32([(libc::SYS_clone3, Vec::new())].into())
}

/// System calls that are refused, some only with certain arguments.
fn refused() -> anyhow::Result<Calls> {
    let always = [
        // The network. `socketpair` connects nothing but the process with itself.
        libc::SYS_socket,
        libc::SYS_connect,
        libc::SYS_bind,
        libc::SYS_listen,
        libc::SYS_shutdown,
        // Permissions of files, which Landlock does not know.
        libc::SYS_fchmod,
        libc::SYS_fchmodat,
        libc::SYS_fchmodat2,
        libc::SYS_fchown,
        libc::SYS_fchownat,
        libc::SYS_setxattr,
        libc::SYS_lsetxattr,
        libc::SYS_fsetxattr,
        libc::SYS_removexattr,
        libc::SYS_lremovexattr,
        libc::SYS_fremovexattr,
        // Other processes.
        libc::SYS_ptrace,
        libc::SYS_process_vm_readv,
        libc::SYS_process_vm_writev,
        libc::SYS_pidfd_open,
        libc::SYS_pidfd_getfd,
        libc::SYS_pidfd_send_signal,
        libc::SYS_rt_sigqueueinfo,
        libc::SYS_rt_tgsigqueueinfo,
        libc::SYS_tkill,
        libc::SYS_setsid,
        libc::SYS_kcmp,
        // Memory and messages that any process can share. `shm_open` is a file.
        libc::SYS_shmget,
        libc::SYS_shmat,
        libc::SYS_shmctl,
        libc::SYS_msgget,
        libc::SYS_msgsnd,
        libc::SYS_msgrcv,
        libc::SYS_msgctl,
        libc::SYS_semget,
        libc::SYS_semop,
        libc::SYS_semtimedop,
        libc::SYS_semctl,
        libc::SYS_mq_open,
        libc::SYS_mq_unlink,
        // System calls that bypass this filter, or have had many defects.
        libc::SYS_io_uring_setup,
        libc::SYS_io_uring_enter,
        libc::SYS_io_uring_register,
        libc::SYS_bpf,
        libc::SYS_perf_event_open,
        libc::SYS_userfaultfd,
        libc::SYS_keyctl,
        libc::SYS_add_key,
        libc::SYS_request_key,
        // What only administrators need.
        libc::SYS_mount,
        libc::SYS_umount2,
        libc::SYS_move_mount,
        libc::SYS_open_tree,
        libc::SYS_fsopen,
        libc::SYS_mount_setattr,
        libc::SYS_pivot_root,
        libc::SYS_chroot,
        libc::SYS_unshare,
        libc::SYS_setns,
        libc::SYS_open_by_handle_at,
        libc::SYS_init_module,
        libc::SYS_finit_module,
        libc::SYS_delete_module,
        libc::SYS_kexec_load,
        libc::SYS_reboot,
        libc::SYS_swapon,
        libc::SYS_swapoff,
        libc::SYS_acct,
        libc::SYS_quotactl,
        libc::SYS_settimeofday,
        libc::SYS_clock_settime,
        libc::SYS_adjtimex,
        libc::SYS_clock_adjtime,
        libc::SYS_sethostname,
        libc::SYS_setdomainname,
        libc::SYS_syslog,
    ];
    #[cfg(target_arch = "x86_64")]
    let of_the_processor = [
        libc::SYS_fork,
        libc::SYS_vfork,
        libc::SYS_chmod,
        libc::SYS_chown,
        libc::SYS_lchown,
        libc::SYS_iopl,
        libc::SYS_ioperm,
        libc::SYS_kexec_file_load,
    ];
    #[cfg(not(target_arch = "x86_64"))]
    let of_the_processor = [libc::SYS_kexec_file_load];
    let mut calls: Calls = always.into_iter().chain(of_the_processor).map(|call| (call, Vec::new())).collect();
    let (own, thread) = (u64::from(id()), libc::CLONE_THREAD as u64);
    let fast_open = libc::MSG_FASTOPEN as u64;
    let other = |argument: u8| [(argument, SeccompCmpOp::Ne, 0), (argument, SeccompCmpOp::Ne, own)];
    let conditional: [(i64, &[Condition]); 12] = [
        // A new process. Threads are allowed.
        (libc::SYS_clone, &[(0, SeccompCmpOp::MaskedEq(thread), 0)]),
        // Signals and limits of other processes.
        (libc::SYS_kill, &other(0)),
        (libc::SYS_tgkill, &[(0, SeccompCmpOp::Ne, own)]),
        (libc::SYS_prlimit64, &other(0)),
        // Priorities of other processes, of groups and of users. Calls for the scheduler of a thread stay allowed: libraries make them for
        // their own threads, whose numbers no filter can know.
        (libc::SYS_setpriority, &[(0, SeccompCmpOp::Ne, u64::from(libc::PRIO_PROCESS))]),
        (libc::SYS_setpriority, &other(1)),
        (libc::SYS_ioprio_set, &[(0, SeccompCmpOp::Ne, 1)]),
        (libc::SYS_ioprio_set, &other(1)),
        (libc::SYS_setpgid, &[(1, SeccompCmpOp::Ne, 0)]),
        // Data that connect a socket.
        (libc::SYS_sendto, &[(3, SeccompCmpOp::MaskedEq(fast_open), fast_open)]),
        (libc::SYS_sendmsg, &[(2, SeccompCmpOp::MaskedEq(fast_open), fast_open)]),
        (libc::SYS_sendmmsg, &[(3, SeccompCmpOp::MaskedEq(fast_open), fast_open)]),
    ];
    for (call, conditions) in conditional {
        let conditions = conditions.iter().map(|(argument, compare, value)| {
            SeccompCondition::new(*argument, SeccompCmpArgLen::Dword, compare.clone(), *value)
        });
        // A call is refused if any of its rules applies.
        calls.entry(call).or_default().push(SeccompRule::new(conditions.collect::<Result<_, _>>()?)?);
    }
    Ok(with_x32(calls))
}

/// The same calls also by their numbers of the ABI x32.
fn with_x32(calls: Calls) -> Calls {
    #[cfg(target_arch = "x86_64")]
    let calls = calls.into_iter().flat_map(|(call, rules)| [(call, rules.clone()), (call | X32, rules)]).collect();
    calls
}
