// Exit codes, messages and signals of a whole program.

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "common/runtime/tests/support.hpp"

namespace zloam::runtime {
namespace {

using testing::HasSubstr;
using testing::Not;

/// A child process whose output is read through a pipe.
class Program {
 public:
  /// inherits: descriptors that the child gets beside the standard ones
  explicit Program(std::vector<std::string> arguments, const std::vector<int>& inherits = {}) {
    arguments.insert(arguments.begin(), ZLOAM_TEST_PROGRAM);
    std::vector<char*> argv;
    for (std::string& a : arguments) argv.push_back(a.data());
    argv.push_back(nullptr);
    std::array<int, 2> ends{};
    if (pipe2(ends.data(), O_CLOEXEC) != 0) throw std::runtime_error("pipe");
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_adddup2(&actions, ends[1], 1);
    posix_spawn_file_actions_adddup2(&actions, ends[1], 2);
    // Duplicating a descriptor onto itself keeps it open in the child.
    for (const int each : inherits) posix_spawn_file_actions_adddup2(&actions, each, each);
    if (posix_spawn(&pid_, argv[0], &actions, nullptr, argv.data(), environ) != 0) {
      throw std::runtime_error("spawn");
    }
    posix_spawn_file_actions_destroy(&actions);
    close(ends[1]);
    output_ = fdopen(ends[0], "r");
  }
  ~Program() {
    if (pid_ > 0) {
      kill(pid_, SIGKILL);
      waitpid(pid_, nullptr, 0);
    }
    fclose(output_);
  }
  /// Reads until a line holds the text.
  bool read_until(const std::string& text) {
    std::array<char, 4096> line{};
    while (fgets(line.data(), line.size(), output_) != nullptr) {
      all_ += line.data();
      if (all_.find(text) != std::string::npos) return true;
    }
    return false;
  }
  void signal(int number) const { kill(pid_, number); }
  int exit_code() {
    read_until("\x01 never there");
    int status = 0;
    waitpid(pid_, &status, 0);
    pid_ = -1;
    return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
  }
  const std::string& output() const { return all_; }

 private:
  pid_t pid_ = -1;
  FILE* output_ = nullptr;
  std::string all_;
};

std::string set_port(int port) { return "--set=zenoh.base_port=" + std::to_string(port); }

TEST(Program, HelpAndDescriptionsEndWithZero) {
  Program help({"--help"});
  EXPECT_EQ(help.exit_code(), 0);
  EXPECT_THAT(help.output(), HasSubstr("Exit codes"));
  EXPECT_THAT(help.output(), Not(HasSubstr("ZLOAM_FAULT")));  // only tests need those
  Program describe({"--describe-config"});
  EXPECT_EQ(describe.exit_code(), 0);
  EXPECT_THAT(describe.output(), HasSubstr("registration.value"));
  Program check({"--check-config", "--set", "registration.value=1.5"});
  EXPECT_EQ(check.exit_code(), 0);
  EXPECT_THAT(check.output(), HasSubstr("\"registration.value\":1.5"));
}

TEST(Program, ADescriptionThatFindsNoRoomEndsWithThree) {
  for (const char* option : {"--describe-config", "--check-config"}) {
    const std::string command = std::string(ZLOAM_TEST_PROGRAM) + " " + option + " > /dev/full";
    const int status = std::system(command.c_str());
    EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 3) << option;
  }
}

TEST(Program, WrongUseEndsWithTwo) {
  for (const std::vector<std::string>& arguments : {std::vector<std::string>{"--no-such-option"},
                                                    {"--set", "registration.value=3"},
                                                    {"--set", "registration.valu=1"},
                                                    {"--instance", "a/b"},
                                                    {"stray"}}) {
    Program program(arguments);
    EXPECT_EQ(program.exit_code(), 2) << arguments[0];
    EXPECT_FALSE(program.output().empty());
  }
  const auto path = std::filesystem::temp_directory_path() /
                    ("zloam-program-test-" + std::to_string(getpid()) + ".yaml");
  std::ofstream(path) << "robot: r\nregistration:\n  value: 7\n";
  Program program({"--config", path.string()});
  EXPECT_EQ(program.exit_code(), 2);
  EXPECT_THAT(program.output(),
              HasSubstr(path.string() + ":3: registration.value: value '7' is refused: out of "
                                        "range; allowed: 0 to 2 m"));
  std::filesystem::remove(path);
}

TEST(Program, FilesAndPortsThatCantBeHadEndWithThree) {
  Program file({"--config", "/nowhere/robot.yaml"});
  EXPECT_EQ(file.exit_code(), 3);
  EXPECT_THAT(file.output(), HasSubstr("/nowhere/robot.yaml"));
  Program io({"--set=registration.fail=io", set_port(0)});
  EXPECT_EQ(io.exit_code(), 3);

  // registration listens on the port after the base.
  const int taken = test::free_port();
  Program first({set_port(taken - 1)});
  ASSERT_TRUE(first.read_until("started"));
  Program second({set_port(taken - 1)});
  EXPECT_EQ(second.exit_code(), 3);
  EXPECT_THAT(second.output(), HasSubstr(std::to_string(taken)));
  EXPECT_THAT(second.output(), HasSubstr("zenoh.base_port"));
  first.signal(SIGTERM);
  EXPECT_EQ(first.exit_code(), 0);
}

TEST(Program, HealthAsksTheOneThatRuns) {
  const int port = test::free_port();
  const std::vector<std::string> question = {"--health", set_port(port - 1)};
  Program nobody(question);
  EXPECT_EQ(nobody.exit_code(), 1);
  Program stage({set_port(port - 1), "--instance=a"});
  ASSERT_TRUE(stage.read_until("started"));
  Program ready(question);
  EXPECT_EQ(ready.exit_code(), 0);
  EXPECT_THAT(ready.output(), HasSubstr("Ready"));
  Program other({"--health", set_port(port - 1), "--instance=b"});
  EXPECT_EQ(other.exit_code(), 1);
  EXPECT_THAT(other.output(), HasSubstr("no answer"));
  stage.signal(SIGTERM);
  EXPECT_EQ(stage.exit_code(), 0);
}

TEST(Program, AliveIsWhoAnswersReadyOrNot) {
  const int port = test::free_port();
  const std::vector<std::string> question = {"--alive", set_port(port - 1)};
  Program nobody(question);
  EXPECT_EQ(nobody.exit_code(), 1);
  Program stage({set_port(port - 1), "--set=registration.fail=waits"});
  ASSERT_TRUE(stage.read_until("started"));
  Program ready({"--health", set_port(port - 1)});
  EXPECT_EQ(ready.exit_code(), 1);
  EXPECT_THAT(ready.output(), HasSubstr("Starting: nothing to work on"));
  Program alive(question);
  EXPECT_EQ(alive.exit_code(), 0);
  EXPECT_THAT(alive.output(), HasSubstr("Starting: nothing to work on"));
  stage.signal(SIGSTOP);
  Program hangs(question);
  EXPECT_EQ(hangs.exit_code(), 1);
  stage.signal(SIGCONT);
  stage.signal(SIGTERM);
  EXPECT_EQ(stage.exit_code(), 0);
}

TEST(Program, AnythingElseEndsWithOne) {
  Program other({"--set=registration.fail=other", set_port(0)});
  EXPECT_EQ(other.exit_code(), 1);
  EXPECT_THAT(other.output(), HasSubstr("anything else"));
  Program later({"--set=registration.fail=later", set_port(0)});
  EXPECT_EQ(later.exit_code(), 1);
  EXPECT_THAT(later.output(), HasSubstr("gave up"));
}

TEST(Program, AFileThatIsMissingAtTheEndEndsWithThree) {
  Program program({"--set=registration.fail=unsaved", set_port(0)});
  ASSERT_TRUE(program.read_until("started"));
  program.signal(SIGTERM);
  EXPECT_EQ(program.exit_code(), 3);
  EXPECT_THAT(program.output(), HasSubstr("the disk is full"));
  // Whatever else can be saved is saved.
  EXPECT_THAT(program.output(), HasSubstr("saved before the end"));
}

TEST(Program, EndsWhenWhoStartedItIsGone) {
  std::array<int, 2> pipe{};
  ASSERT_EQ(pipe2(pipe.data(), O_CLOEXEC), 0);
  setenv("ZLOAM_PARENT_PIPE", std::to_string(pipe[0]).c_str(), 1);
  Program program({set_port(0)}, {pipe[0]});
  unsetenv("ZLOAM_PARENT_PIPE");
  close(pipe[0]);
  ASSERT_TRUE(program.read_until("started"));
  close(pipe[1]);  // as the kernel does for a process that dies of whatever
  EXPECT_EQ(program.exit_code(), 0);
  EXPECT_THAT(program.output(), HasSubstr("saved before the end"));
}

TEST(Program, APipeThatIsNoneIsSaid) {
  setenv("ZLOAM_PARENT_PIPE", "77x", 1);
  Program program({set_port(0)});
  unsetenv("ZLOAM_PARENT_PIPE");
  ASSERT_TRUE(program.read_until("started"));
  program.signal(SIGTERM);
  EXPECT_EQ(program.exit_code(), 0);
  EXPECT_THAT(program.output(), HasSubstr("ZLOAM_PARENT_PIPE names no pipe"));
}

TEST(Program, AHangUpThatIsIgnoredEndsNothing) {  // as under nohup
  std::signal(SIGHUP, SIG_IGN);
  Program program({set_port(0)});
  std::signal(SIGHUP, SIG_DFL);
  ASSERT_TRUE(program.read_until("started"));
  program.signal(SIGHUP);
  program.signal(SIGTERM);
  EXPECT_EQ(program.exit_code(), 0);
  EXPECT_THAT(program.output(), HasSubstr("SIGTERM"));
}

TEST(Program, EndsCleanlyOnSignals) {
  for (const int number : {SIGTERM, SIGINT, SIGHUP}) {
    Program program({set_port(0), "--set=log.format=json"});
    ASSERT_TRUE(program.read_until("started"));
    program.signal(number);
    EXPECT_EQ(program.exit_code(), 0);
    EXPECT_THAT(program.output(), HasSubstr("saved before the end"));
    EXPECT_THAT(program.output(), HasSubstr("{\"time\":"));
  }
}

}  // namespace
}  // namespace zloam::runtime
